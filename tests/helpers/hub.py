"""A Hub of this machine: the requests that `huggingface_hub` makes, answered over HTTP out of memory.

Small files alone: all are sent inside the commit, none by LFS or Xet.
"""

import base64
import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any
from urllib.parse import unquote, urlsplit


class Hub:
    """Repositories by "datasets/OWNER/NAME" or "models/OWNER/NAME": their commits, each all files, the last the newest.

    `served` are the paths of files that were sent.
    """

    def __init__(self) -> None:
        self.commits: dict[str, list[dict[str, bytes]]] = {}
        self.private: dict[str, bool] = {}
        self.served: list[str] = []

    def files(self, name: str) -> dict[str, bytes]:
        """The newest commit."""
        return self.commits[name][-1]

    def add(self, name: str, files: dict[str, bytes]) -> None:
        """One more commit, of these files alone."""
        self.commits.setdefault(name, []).append(files)

    def at(self, name: str, revision: str) -> dict[str, bytes]:
        """The files of a commit."""
        names = [commit_name(number) for number in range(len(self.commits[name]))]
        return self.files(name) if revision == "main" else self.commits[name][names.index(revision)]

    def change(self, name: str, operations: list[dict[str, Any]]) -> str:
        """Commit what the client sends; its name."""
        files = dict(self.files(name))
        for operation in operations:
            value = operation["value"]
            if operation["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif operation["key"] == "deletedFile":
                del files[value["path"]]
        self.add(name, files)
        return commit_name(len(self.commits[name]) - 1)


def commit_name(number: int) -> str:
    """What the commit of this number is called."""
    return f"{number:040x}"


def page_of(name: str) -> str:
    """The address of a repository as the Hub tells it; of models without "models/"."""
    return f"https://huggingface.co/{name.removeprefix('models/')}"


class _Answers(BaseHTTPRequestHandler):
    hub: Hub

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["Content-Length"]))
        parts = urlsplit(self.path).path.strip("/").split("/")
        if parts[1:] == ["repos", "create"]:
            asked = json.loads(body)
            name = f"{asked.get('type', 'model')}s/{asked['organization']}/{asked['name']}"
            made = name not in self.hub.commits
            if made:
                self.hub.add(name, {})
                self.hub.private[name] = asked["visibility"] == "private"
            self.answer({"url": page_of(name)}, 200 if made else 409)
        elif parts[1] == "validate-yaml":
            self.answer({"warnings": [], "errors": []})
        elif parts[4] == "preupload":
            files = json.loads(body)["files"]
            modes = [{"path": each["path"], "uploadMode": "regular", "shouldIgnore": False} for each in files]
            self.answer({"files": modes})
        else:
            name = "/".join(parts[1:4])
            made_of = self.hub.change(name, [json.loads(line) for line in body.splitlines()])
            self.answer({"commitUrl": f"{page_of(name)}/commit/{made_of}", "commitOid": made_of})

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        parts = unquote(urlsplit(self.path).path).strip("/").split("/")
        if parts[0] != "api":
            parts = parts if parts[0] == "datasets" else ["models", *parts]
            self.send_file("/".join(parts[:3]), parts[4], "/".join(parts[5:]))
            return
        name = "/".join(parts[1:4])
        if name not in self.hub.commits:
            self.answer({"error": "Repository not found"}, 404, {"X-Error-Code": "RepoNotFound"})
        elif parts[4:5] == ["tree"]:
            below = "/".join(parts[6:])
            self.answer(
                [
                    {"type": "file", "path": path, "size": len(content), "oid": hashlib.sha1(content).hexdigest()}
                    for path, content in self.hub.at(name, parts[5]).items()
                    if path.startswith(f"{below}/" if below else "")
                ]
            )
        else:
            last = commit_name(len(self.hub.commits[name]) - 1)
            facts = {"id": name.partition("/")[2], "sha": last, "private": self.hub.private.get(name, False)}
            self.answer({**facts, "tags": [], "downloads": 0, "likes": 0, "siblings": []})

    def send_file(self, name: str, revision: str, path: str) -> None:
        content = self.hub.at(name, revision).get(path)
        if content is None:
            self.answer({"error": "Entry not found"}, 404, {"X-Error-Code": "EntryNotFound"})
            return
        etag = {"ETag": f'"{hashlib.sha256(content).hexdigest()}"', "X-Repo-Commit": revision}
        if self.command == "GET":
            self.hub.served.append(path)
        self.reply(content, 200, etag)

    def answer(self, value: Any, status: int = 200, headers: dict[str, str] | None = None) -> None:
        self.reply(json.dumps(value).encode(), status, {"Content-Type": "application/json", **(headers or {})})

    def reply(self, content: bytes, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def local_hub() -> Iterator[tuple[Hub, str]]:
    """A Hub without repositories, and its address, while the block runs."""
    hub = Hub()
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Answers", (_Answers,), {"hub": hub}))
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield hub, f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
