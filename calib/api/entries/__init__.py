"""What each analysis has to say beside its answer: paragraphs, warnings and tables, for the command and for Python."""
