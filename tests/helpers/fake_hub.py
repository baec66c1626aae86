"""The Hugging Face Hub behind its client's HTTP door: repositories in memory, a log-in, and what goes wrong there."""

import base64
import json
import re
from collections.abc import Callable
from typing import Any

TOKEN = "hf_of_a_test"
_API = r"/api/models/(?P<id>[\w.-]+/[\w.-]+)"


class FakeHub:
    """Answers the client's requests.

    Attributes:
        repositories: The files of each, by name.
        requests: Method and path of every request.
        private: The repositories that were made so.
    """

    def __init__(self, httpx: Any) -> None:
        self._httpx = httpx
        self.repositories: dict[str, dict[str, bytes]] = {}
        self.messages: list[str] = []
        self.private: set[str] = set()
        self.requests: list[tuple[str, str]] = []
        self._routes: list[tuple[str, str, Callable[..., Any]]] = [
            ("GET", r"/api/agent-harnesses", lambda request: self._json({})),
            ("GET", r"/api/whoami-v2", self._whoami),
            ("POST", r"/api/repos/create", self._create),
            ("POST", r"/api/validate-yaml", lambda request: self._json({"errors": [], "warnings": []})),
            ("POST", _API + "/preupload/main", self._preupload),
            ("POST", _API + "/commit/main", self._commit),
            ("GET", _API, self._info),
            ("HEAD|GET", r"/(?P<id>[\w.-]+/[\w.-]+)/resolve/(?P<commit>\w+)/(?P<file>.+)", self._file),
        ]

    def client(self) -> Any:
        """Return what the Hub's client sends its requests with."""
        return self._httpx.Client(transport=self._httpx.MockTransport(self._answer), follow_redirects=True)

    def _answer(self, request: Any) -> Any:
        self.requests.append((request.method, request.url.path))
        for method, pattern, route in self._routes:
            found = re.fullmatch(pattern, request.url.path)
            if not found or not re.fullmatch(method, request.method):
                continue
            names = found.groupdict()
            if names and names["id"] not in self.repositories:
                return self._refusal(404, "RepoNotFound", "Repository not found")
            return route(request, **names)
        raise AssertionError(f"an unexpected request: {request.method} {request.url}")

    def _json(self, content: Any) -> Any:
        return self._httpx.Response(200, json=content)

    def _refusal(self, status: int, code: str, message: str) -> Any:
        return self._httpx.Response(status, headers={"X-Error-Code": code, "X-Error-Message": message})

    def _logged_in(self, request: Any) -> bool:
        return bool(request.headers.get("authorization") == f"Bearer {TOKEN}")

    def _whoami(self, request: Any) -> Any:
        if not self._logged_in(request):
            return self._refusal(401, "", "Invalid user token.")
        return self._json({"type": "user", "name": "me", "orgs": []})

    def _create(self, request: Any) -> Any:
        content = json.loads(request.content)
        name = f"{content.get('organization', 'me')}/{content['name']}"
        if not self._logged_in(request) or name.startswith("others/"):
            return self._refusal(403, "", "You don't have the rights to create a model there")
        self.repositories.setdefault(name, {})
        if content.get("private") or content.get("visibility") == "private":
            self.private.add(name)
        return self._json({"url": f"https://huggingface.co/{name}", "name": name, "id": name})

    def _preupload(self, request: Any, id: str) -> Any:
        files = [{"path": file["path"], "uploadMode": "regular"} for file in json.loads(request.content)["files"]]
        return self._json({"files": [{**file, "shouldIgnore": False} for file in files]})

    def _commit(self, request: Any, id: str) -> Any:
        lines = [json.loads(line) for line in request.read().splitlines()]
        for line in lines:
            if line["key"] == "header":
                self.messages.append(line["value"]["summary"])
            else:
                assert line["key"] == "file" and line["value"]["encoding"] == "base64"
                self.repositories[id][line["value"]["path"]] = base64.b64decode(line["value"]["content"])
        return self._json({"success": True, "commitOid": "c0ffee", "commitUrl": f"https://huggingface.co/{id}"})

    def _info(self, request: Any, id: str) -> Any:
        files = [{"rfilename": name, "size": len(content)} for name, content in self.repositories[id].items()]
        return self._json({"id": id, "sha": "c0ffee", "siblings": files, "tags": [], "downloads": 0, "private": False})

    def _file(self, request: Any, id: str, commit: str, file: str) -> Any:
        content = self.repositories[id].get(file)
        if content is None:
            return self._refusal(404, "EntryNotFound", "Entry not found")
        headers = {"X-Repo-Commit": "c0ffee", "ETag": f'"{hash(content)}"', "Content-Length": str(len(content))}
        return self._httpx.Response(200, headers=headers, content=b"" if request.method == "HEAD" else content)
