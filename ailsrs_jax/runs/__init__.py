"""Whole runs: on disk, with progress, evaluated."""
