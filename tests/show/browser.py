"""Pages in a real browser, without a screen."""

import json
import shutil
import subprocess
from pathlib import Path

BROWSER = next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chrome"))), None)
SILENT = "--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --no-first-run"
ALONE = "--disable-background-networking --disable-component-update --disable-sync"


def open_in_browser(page: Path, log: Path) -> tuple[str, list[str], list[str]]:
    """The document after loading, what the console says, and the addresses that are asked for."""
    assert BROWSER is not None
    options = [*SILENT.split(), *ALONE.split(), f"--user-data-dir={log.parent / 'profile'}"]
    options += [f"--log-net-log={log}", "--enable-logging=stderr", "--dump-dom", page.as_uri()]
    ran = subprocess.run([BROWSER, *options], capture_output=True, text=True, timeout=240)
    assert ran.returncode == 0, ran.stderr
    console = [line for line in ran.stderr.splitlines() if "CONSOLE" in line]
    events = [event.get("params", {}) for event in json.loads(log.read_text())["events"]]
    # The browser itself asks for this and that, without an origin.
    asked = {
        event["url"]
        for event in events
        if event.get("initiator", "not an origin") != "not an origin"
        and not event["url"].startswith("data:")
    }
    return ran.stdout, console, sorted(asked)
