"""Pure maths: knows no environment, no file and no training loop."""
