"""Objects from a user's own files, named ``module:attribute``, and the errors in these files.

People may name any code on the command line or in Python. A file may come from a stranger, so code
that only a file names is not imported, not even to find out what it is.
"""

import contextlib
import functools
import importlib
import inspect
import operator
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ailsrs_jax.errors import UserError, did_you_mean, one_line

_allowed: set[str | None] = set()


def is_own(name: str) -> bool:
    """Tell whether ``name`` has the form ``module:attribute``; nothing is imported."""
    return ":" in name


def allow(*names: str | None) -> None:
    """Allow files to name this code, because the user has named it in this process.

    None stands for no name.
    """
    _allowed.update(names)


def require_allowed(name: str, source: str, option: str = "--env") -> None:
    """Raise UserError if ``name`` is code of others that only the file ``source`` names.

    Args:
        name: ``module:attribute`` or another name, which is harmless.
        source: the file, for the message.
        option: of the command line, with which the user allows the name.
    """
    if is_own(name) and name not in _allowed:
        raise UserError(
            f"{source} names {name}, code that could do anything, so it is not imported: if you "
            f"trust it, repeat its name with {option} {name}"
        )


def search_here() -> None:
    """Look for modules in the current directory first, as ``python -m`` does."""
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))


def load_own(name: str) -> Any:
    """Import ``module:attribute``; modules are looked for in the current directory first.

    Raises:
        UserError: the module cannot be imported, or has no such attribute.
    """
    module_name, _, attribute = name.partition(":")
    search_here()
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # the code of others may raise anything
        if isinstance(error, ModuleNotFoundError) and error.name == module_name.split(".")[0]:
            raise UserError(f"cannot find {name}: there is no module {error.name} here") from error
        file = module_name.split(".")[-1] + ".py"
        raise _blame(f"cannot import {name}", error, file) from error
    try:
        return operator.attrgetter(attribute)(module)
    except AttributeError as error:
        hint = did_you_mean(attribute, dir(module))
        raise UserError(
            f"{getattr(module, '__file__', module_name)}, line 1: there is no '{attribute}'{hint}"
        ) from error


def own_function(name: str) -> Callable[..., Any]:
    """Return the function ``module:attribute``, whose exceptions become UserErrors."""
    function = load_own(name)
    if not callable(function):
        raise UserError(f"{name} is of type {type(function).__name__}: it must be a function")

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        with blamed_on(name, function):
            return function(*arguments)

    return call


@contextlib.contextmanager
def blamed_on(name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Report an exception from inside as a mistake in the file of ``name``, ``module:attribute``.

    The line is the last one of that file that the exception passed through; if there is none, as
    with a wrong signature, the one where ``function`` begins.

    Raises:
        UserError: there was an exception.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        file = str(getattr(sys.modules.get(name.partition(":")[0]), "__file__", name))
        code = getattr(inspect.unwrap(function), "__code__", None)  # a class has none
        line = code.co_firstlineno if code is not None and code.co_filename == file else 1
        raise _blame(name, error, file, line) from error


def _blame(name: str, error: Exception, file: str, line: int = 1) -> UserError:
    """Describe an error in a line, with the last place in ``file`` that it passed through."""
    if isinstance(error, SyntaxError) and error.filename is not None:
        file, line = error.filename, error.lineno or line
    for frame, number in traceback.walk_tb(error.__traceback__):
        if Path(frame.f_code.co_filename).name == Path(file).name:
            file, line = frame.f_code.co_filename, number
    with tempfile.NamedTemporaryFile("w", prefix="ailsrs-", suffix=".log", delete=False) as log:
        log.write("".join(traceback.format_exception(error)))
    return UserError(
        f"{name}: {file}, line {line}: {one_line(error)}; the traceback is in {log.name}"
    )
