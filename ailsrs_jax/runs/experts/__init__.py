"""Training experts on the environment's reward."""
