"""Tell what demonstrations hold, and how a run went."""
