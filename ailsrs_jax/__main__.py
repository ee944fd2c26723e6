"""The program ``ailsrs``, also as ``python -m ailsrs_jax``."""

from ailsrs_jax.cli.signals import end_on_ctrl_c
from ailsrs_jax.cli.streams import forgiving_streams


def main() -> None:
    """Run the command line; from now on Ctrl-C ends it in one line."""
    end_on_ctrl_c()
    with forgiving_streams():
        from ailsrs_jax.cli.main import main  # takes half a second

        main()


if __name__ == "__main__":
    main()
