"""The pages of ``ailsrs report``."""
