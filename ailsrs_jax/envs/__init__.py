"""Gymnasium's MuJoCo v5 tasks as Brax environments, on three physics engines."""

import contextlib
import io

from ailsrs_jax.versions import require_supported

require_supported()

# Brax imports MJX, which prints a line for each optional backend that is missing.
with contextlib.redirect_stdout(io.StringIO()):
    from brax.envs.base import Env as Env
    from brax.envs.base import State as State
    from brax.envs.base import Wrapper as Wrapper
