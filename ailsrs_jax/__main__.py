"""``python -m ailsrs_jax`` is ``ailsrs``."""

from ailsrs_jax.cli import main

main()
