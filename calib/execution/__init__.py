"""Evaluation of points and tasks, in this process or in others."""
