"""Inference: least squares, genetic search, posterior covariance, identifiability and leave-one-out prediction."""
