"""Demonstrations and policies in memory and on disk; independent of training."""
