"""The documentation as a site: ``make docs``.

The pages are the Markdown files of the repository in their places, so links work both on a code
host and on the site. The page of the command line is made from the help of the commands, and the
Python reference from docstrings. Nothing is loaded from the network, neither by the build nor by a
reader's browser: formulas are MathML, and fonts are the reader's own.
"""

import dataclasses
import importlib
import os
import re
import subprocess
import sys
from importlib.metadata import version as installed_version
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx

import ailsrs_jax
from ailsrs_jax.cli.main import app as command_line

project = "ailsrs_jax"
copyright = "the ailsrs_jax developers"  # noqa: A001
release = installed_version(project)

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = [
    "docs/*.md",
    "experiments/RESULTS.md",
    "experiments/results/*/*.md",
    "ailsrs_jax/data/experts/README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
]

html_theme = "furo"
html_title = project
html_additional_pages = {"index": "redirect.html"}
html_show_sphinx = False
html_copy_source = False
templates_path = ["templates"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True  # fields are members already
python_maximum_signature_line_length = 80

# The parts of the Python reference: the folder of the public names, and the title of the part.
PARTS = {
    "runs": "Whole runs",
    "data": "Demonstrations and policies",
    "envs": "Environments",
    "trainers": "Trainers and their settings",
    "show": "Videos and reports",
    "sweeps": "Sweeps",
    "errors": "Mistakes",
}
# Classes that public functions return and that users do not create.
RETURNED = ("runs.storage.journal.Result", "runs.evaluation.Evaluation", "data.episodes.Recording")


def setup(app: Sphinx) -> None:
    """Register the generated parts with Sphinx."""
    app.add_html_math_renderer("mathml", (_visit_math, None), (_visit_math, None))
    app.config.html_math_renderer = "mathml"
    app.connect("source-read", _add_generated)
    app.connect("autodoc-process-signature", _without_fields)


def _visit_math(translator: Any, node: nodes.math | nodes.math_block) -> None:
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    translator.body.append(convert(node.astext(), display=display))
    raise nodes.SkipNode


def _add_generated(_: Sphinx, page: str, source: list[str]) -> None:
    if page == "docs/command_line":
        source[0] += "".join(_help(command) for command in command_line._subcommands)
    if page == "docs/reference":
        source[0] += _reference()
    if page == "experiments/RESULTS":  # a folder has a page only on a code host
        source[0] = re.sub(r", \[[^]]*\]\(results/\w+/figures\)", "", source[0])
    if page.startswith("experiments/results/"):  # RESULTS.md links to it; it has no title
        *_, sweep, table = page.split("/")
        source[0] = f"---\norphan: true\n---\n\n# {sweep}: {table}\n\n{source[0]}"


def _without_fields(*event: Any) -> tuple[str, None] | None:
    """Leave out the signatures of dataclasses: their fields are documented one by one."""
    _, what, _, found, *_ = event
    return ("", None) if what == "class" and dataclasses.is_dataclass(found) else None


def _help(command: str) -> str:
    """Return the help of a command, 88 columns wide."""
    done = subprocess.run(
        [sys.executable, "-m", "ailsrs_jax", command, "--help"],
        env={**os.environ, "COLUMNS": "88", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    return f"\n## {command}\n\n```text\n{done.stdout.rstrip()}\n```\n"


def _reference() -> str:
    """Return the entries of all public names by folder, functions first."""
    parts: dict[str, list[str]] = {title: [] for title in PARTS.values()}
    for name in sorted(ailsrs_jax.__all__, key=lambda name: (name[0].isupper(), name)):
        home = ailsrs_jax._HOMES[name]
        parts[PARTS[home.split(".")[0]]].append(_entry(f"ailsrs_jax.{name}"))
    others = [path for path in RETURNED if path.split(".")[-1] not in ailsrs_jax.__all__]
    parts["What they return"] = [_entry(f"ailsrs_jax.{path}") for path in others]
    return "".join(
        f"\n## {title}\n\n```{{eval-rst}}\n{''.join(entries)}```\n"
        for title, entries in parts.items()
        if entries
    )


def _entry(name: str) -> str:
    """Return the directive that documents a name, with all members of a class that are ours."""
    module, _, attribute = name.rpartition(".")
    found = getattr(importlib.import_module(module), attribute)
    if not isinstance(found, type):
        return f".. autofunction:: {name}\n"
    theirs = [base.__name__ for base in found.__mro__ if not base.__module__.startswith(project)]
    options = {"members": "", "undoc-members": "", "inherited-members": ", ".join(theirs)}
    lines = "".join(f"   :{option}: {value}\n" for option, value in options.items())
    return f".. autoclass:: {name}\n{lines}\n"
