"""What MkDocs needs to know of this repository: links that lead out of `docs/` keep working in the built pages.

The texts are written to be read in the repository. In the site the README is the first page, and each file outside of
`docs/` that a page links to is added under its own path: Markdown as a page, anything else as it is.
"""

import os.path
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parent.parent
DOCS, HOME = "docs/", ("README.md", "index.md")  # in the repository, in the site
REMARK = re.compile(r"^(\$ .*\S) {3,}(?=# )", re.MULTILINE)  # behind a command, in a column of its own
LINK = re.compile(r"(?<=\]\()(?!\w+:)([^)#\s]+)")  # the relative target of [text](target#anchor), without the anchor


def to_site(path: str) -> str:
    """Return where a file of the repository is in the site."""
    return HOME[1] if path == HOME[0] else path.removeprefix(DOCS)


def to_repository(uri: str) -> str:
    """Return where a file of the site is in the repository."""
    if uri == HOME[1]:
        return HOME[0]
    return DOCS + uri if (ROOT / DOCS / uri).is_file() else uri


def target(page: str, link: str) -> str:
    """Return the file that a page of the repository links to."""
    return os.path.normpath(os.path.join(os.path.dirname(page), link))


def on_files(files: Files, config: Any) -> Files:
    """Add the README and, from page to page, what is linked to."""
    pages = [HOME[0], *(to_repository(page.src_uri) for page in files.documentation_pages())]
    for page in pages:  # it grows on the way
        if to_site(page) not in files.src_uris:
            files.append(File.generated(config, to_site(page), abs_src_path=str(ROOT / page)))
        links = LINK.findall((ROOT / page).read_text(encoding="utf-8")) if page.endswith(".md") else []
        found = (target(page, link) for link in links)
        pages += [path for path in found if path not in pages and (ROOT / path).is_file()]
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let the links lead to where their targets are in the site, of which MkDocs warns if there is none."""
    here = to_repository(page.file.src_uri)

    def moved(match: re.Match[str]) -> str:
        return os.path.relpath(to_site(target(here, match[1])), os.path.dirname(page.file.src_uri) or ".")

    return LINK.sub(moved, REMARK.sub(r"\1  ", markdown))  # commands are wrapped, see style.css
