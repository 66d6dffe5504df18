"""Tables and their safe writing, fingerprints, and the ledger of evaluations."""
