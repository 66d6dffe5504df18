"""Elements and assembly: beams, springs, dampers and point masses on frames of lines."""
