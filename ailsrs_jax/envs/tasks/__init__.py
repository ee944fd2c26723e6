"""Gymnasium's MuJoCo v5 tasks, one to a file."""
