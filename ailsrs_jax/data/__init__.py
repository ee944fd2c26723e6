"""Demonstrations, policies and experts on disk: knows no training."""
