"""The pages fit into a desktop's and a phone's window, commands included, and the browser does not complain."""

import http.server
import json
import queue
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
CHROMIUM = next((found for name in ("chromium", "google-chrome", "chrome") if (found := shutil.which(name))), None)
WIDTHS = (1280, 390)  # [px], a desktop and a phone
# Loads every page into a frame of each width, and sends how much wider its content is, and commands that are cut.
MEASURE = """<!doctype html><body><script>
const pages = %s, widths = %s, result = {};
(async () => {
  for (const width of widths) for (const page of pages) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `width: ${width}px; height: 900px; border: 0`;
    frame.src = page;
    document.body.append(frame);
    await new Promise(resolve => frame.onload = resolve);
    const root = frame.contentDocument.documentElement;
    result[`${page} at ${width}`] = root.scrollWidth - width;
    for (const block of root.querySelectorAll(".language-console code"))
      if (block.scrollWidth > block.clientWidth)
        result[`${block.innerText} in ${page} at ${width}`] = block.scrollWidth;
    frame.remove();
  }
  await fetch("/result", {method: "POST", body: JSON.stringify(result)});
})();
</script></body>"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium on the PATH"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason='pip install -e ".[docs]"')
    folder = tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    return folder


def measured(site: Path, profile: Path) -> tuple[dict[str, int], list[str]]:
    """What `measure.html` sends, and what the browser's console said."""
    results: queue.Queue[dict[str, int]] = queue.Queue()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args, directory=str(site))

        def do_POST(self) -> None:
            results.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *args: object) -> None: ...

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    flags = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", f"--user-data-dir={profile}"]
    log = profile.with_suffix(".log")
    with log.open("w") as stderr:
        url = f"http://127.0.0.1:{server.server_port}/measure.html"
        browser = subprocess.Popen([str(CHROMIUM), *flags, "--remote-debugging-port=0", url], stderr=stderr)
        try:
            return results.get(timeout=200), re.findall(r'CONSOLE.*?"(.*?)", source', log.read_text())
        finally:
            browser.kill()
            browser.wait()
            server.shutdown()


def test_no_page_is_wider_than_its_window_and_no_console_complains(site: Path, tmp_path: Path) -> None:
    pages = sorted(f"/{path.relative_to(site)}" for path in site.rglob("index.html"))
    assert len(pages) > 15
    (site / "measure.html").write_text(MEASURE % (json.dumps(pages), json.dumps(WIDTHS)))
    result, complaints = measured(site, tmp_path / "browser")
    assert len(result) >= len(pages) * len(WIDTHS)
    assert {page: by for page, by in result.items() if by > 0} == {}
    assert complaints == []
