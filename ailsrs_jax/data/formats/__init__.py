"""File formats, each in a module that knows arrays and episodes but no classes of this package."""
