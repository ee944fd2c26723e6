"""Pages in a real browser, without a screen."""

import http.server
import json
import shutil
import subprocess
import threading
from pathlib import Path
from typing import Any

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


def ask_in_browser(html: str, script: str, directory: Path) -> tuple[Any, list[str], list[str]]:
    """What ``script``, the body of an asynchronous function, returns in the page ``html``.

    Also what the console says, and the addresses that are asked for. The page may load nothing
    else than a picture, which keeps the browser waiting, and may tell nobody but this function.
    """
    answers: list[str] = []
    answered = threading.Event()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answered.wait(200)
            self.send_response(200)
            self.send_header("Content-Type", "image/svg+xml")
            self.end_headers()
            self.wfile.write(b'<svg xmlns="http://www.w3.org/2000/svg"/>')

        def do_POST(self) -> None:
            answers.append(self.rfile.read(int(self.headers["Content-Length"])).decode())
            self.send_response(204)
            self.end_headers()
            answered.set()

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    here = f"http://127.0.0.1:{server.server_port}/"
    html = html.replace(
        "default-src 'none'", f"default-src 'none'; img-src {here}; connect-src {here}"
    )
    added = f"""<img src="{here}"><script type="module">
      const body = async () => {{ {script} }};
      const answer = await body().catch((error) => String(error.stack));
      await fetch("{here}", {{ method: "POST", mode: "no-cors", body: JSON.stringify(answer) }});
    </script>"""
    (directory / "page.html").write_text(html.replace("</body>", f"{added}</body>"))
    try:
        _, console, asked = open_in_browser(directory / "page.html", directory / "log.json")
    finally:
        server.shutdown()
        server.server_close()
    assert len(answers) == 1, console
    return json.loads(answers[0]), console, [address for address in asked if address != here]
