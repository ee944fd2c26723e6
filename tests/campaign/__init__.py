"""A campaign of random faults, for hours; see :mod:`tests.campaign.__main__`."""
