"""``python -m ailsrs_jax`` is ``ailsrs``."""

from ailsrs_jax.cli.main import main

main()
