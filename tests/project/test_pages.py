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
# Loads every page into a frame of each width, and sends how much wider its content is, commands that are cut, and text
# whose contrast (WCAG's, of large text) is too small in the light or the dark scheme.
MEASURE = """<!doctype html><body><script>
const pages = %s, widths = %s, result = {};
const SCHEMES = ["default", "slate"], TEXT = "article :is(p, li, td, th, h1, h2, h3, a:not(.headerlink), code)";
const rgba = (text) => [...text.match(/[\\d.]+/g).map(Number), 1].slice(0, 4);
const over = (top, base) => top.slice(0, 3).map((part, i) => part * top[3] + base[i] * (1 - top[3]));
const linear = (part) => (part /= 255) <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
const luminance = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
function ground(element, view) {
  if (!element) return [255, 255, 255];
  const colour = rgba(view.getComputedStyle(element).backgroundColor);
  return colour[3] == 1 ? colour.slice(0, 3) : over(colour, ground(element.parentElement, view));
}
function contrast(element, view) {
  const below = ground(element, view), ink = over(rgba(view.getComputedStyle(element).color), below);
  const [dark, light] = [luminance(below), luminance(ink)].sort((a, b) => a - b);
  return (light + 0.05) / (dark + 0.05);
}
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
    root.append(frame.contentDocument.createElement("style"));
    root.lastChild.textContent = "* {transition: none !important}";
    for (const scheme of SCHEMES) {
      frame.contentDocument.body.setAttribute("data-md-color-scheme", scheme);
      for (const element of root.querySelectorAll(TEXT))
        if (contrast(element, frame.contentWindow) < 3)
          result[`${element.outerHTML.slice(0, 80)} in ${page}, ${scheme}`] = contrast(element, frame.contentWindow);
    }
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


def test_every_page_fits_its_window_is_readable_in_both_schemes_and_no_console_complains(
    site: Path, tmp_path: Path
) -> None:
    pages = sorted(f"/{path.relative_to(site)}" for path in site.rglob("index.html"))
    assert len(pages) > 15
    (site / "measure.html").write_text(MEASURE % (json.dumps(pages), json.dumps(WIDTHS)))
    result, complaints = measured(site, tmp_path / "browser")
    assert len(result) >= len(pages) * len(WIDTHS)
    assert {page: by for page, by in result.items() if by > 0} == {}
    assert complaints == []
