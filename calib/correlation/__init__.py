"""How far model and measurement are apart: MAC, CoMAC, strain energy, pairing and where-it-fails tables."""
