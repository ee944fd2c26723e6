"""Training: each trainer has init, update and train, and receives arrays, never paths."""
