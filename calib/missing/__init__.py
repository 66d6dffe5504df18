"""What physical effect a model may lack."""
