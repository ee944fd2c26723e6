"""Make the film at the top of the README: experts beside the policies that imitate them.

usage: python -m experiments.film DIRECTORY...    (writes docs/pictures/film.webp)

For each run directory, the film shows the kept policy of the first seed, in the first seconds of
the episode that `ailsrs render` shows. The film in the README shows two cells from ten
demonstrations:

    ailsrs sweep experiments/curves.toml --output runs/curves
    python -m experiments.film runs/curves/cells/halfcheetah-ailsrs-10-seed0
        runs/curves/cells/hopper-ailsrs-10-seed0
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

import ailsrs_jax as ail

FILM = Path(__file__).parent.parent / "docs" / "pictures" / "film.webp"
SECONDS = 3.0
FPS = 20
SIZE = 200  # pixels, height and width of each picture
QUALITY = 25  # at most 100; with 50 the file has a megabyte


def main() -> None:
    """Render the run directories of the command line side by side."""
    try:
        shots = [shot(directory) for directory in sys.argv[1:]]
        if not shots:
            raise ail.UserError("usage: python -m experiments.film DIRECTORY...")
    except ail.UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    first, *others = (Image.fromarray(frame) for frame in np.concatenate(shots, axis=2))
    FILM.parent.mkdir(exist_ok=True)
    first.save(
        FILM,
        save_all=True,
        append_images=others,
        duration=1000 // FPS,  # milliseconds
        loop=0,
        quality=QUALITY,
        method=6,  # the slowest and smallest
    )


def shot(directory: str) -> np.ndarray:
    """Return the frames ``(T, H, W, 3)`` uint8 of expert and policy."""
    animation = ail.render(directory, seconds=SECONDS, size=SIZE)
    times = np.arange(0.0, SECONDS, 1.0 / FPS)
    nearest = np.minimum(times * float(animation.fps), len(animation.frames) - 1)
    return animation.frames[nearest.astype(int)]


if __name__ == "__main__":
    main()
