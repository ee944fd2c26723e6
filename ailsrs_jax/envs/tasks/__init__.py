"""Gymnasium's MuJoCo v5 tasks, one in each module, and their base classes."""
