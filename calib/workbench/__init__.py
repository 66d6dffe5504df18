"""The live page of a study: it reads ledger and tables, and starts the commands that write them."""
