"""A stand-in for the Hugging Face Hub: repositories in memory, behind the paths that its client asks for."""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

COMMIT = "0123456789abcdef0123456789abcdef01234567"


class StandIn(ThreadingHTTPServer):
    """What it holds and what it was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.repositories: dict[str, dict[str, bytes]] = {}
        self.sizes: dict[str, int] = {}
        """What it says of a file, whatever it holds."""
        self.asked: list[str] = []
        self.address = f"http://127.0.0.1:{self.server_address[1]}"


@contextmanager
def stand_in() -> Iterator[StandIn]:
    """Serve one until the block ends."""
    with StandIn() as hub:
        thread = threading.Thread(target=hub.serve_forever, daemon=True)
        thread.start()
        yield hub
        hub.shutdown()
        thread.join()


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: StandIn

    def log_message(self, *_: object) -> None:
        pass

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        path = self.path.partition("?")[0]
        self.server.asked.append(f"POST {path}")
        if path == "/api/repos/create":
            asked = json.loads(body)
            repo = f"{asked['organization']}/{asked['name']}"
            self.server.repositories.setdefault(repo, {})
            self.say({"url": f"{self.server.address}/{repo}", "name": repo, "id": repo})
        elif path.endswith("/preupload/main"):
            modes = [
                {"path": file["path"], "uploadMode": "regular", "shouldIgnore": False}
                for file in json.loads(body)["files"]
            ]
            self.say({"files": modes})
        elif found := re.fullmatch(r"/api/models/(.+)/commit/main", path):
            self.commit(found[1], body)
        else:
            self.say({"errors": [], "warnings": []})  # of a card

    def commit(self, repo: str, body: bytes) -> None:
        for line in map(json.loads, body.splitlines()):
            if line["key"] == "file":
                content = base64.b64decode(line["value"]["content"])
                self.server.repositories[repo][line["value"]["path"]] = content
        address = f"{self.server.address}/{repo}/commit/{COMMIT}"
        self.say({"success": True, "commitOid": COMMIT, "commitUrl": address, "hookOutput": ""})

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        self.server.asked.append(f"{self.command} {path}")
        if found := re.fullmatch(r"/([^/]+/[^/]+)/resolve/[^/]+/(.+)", path):
            content = self.server.repositories[found[1]][found[2]]
            self.answer(content, ETag=f'"{_digest(content)}"', X_Repo_Commit=COMMIT)
            return
        found = re.fullmatch(r"/api/models/([^/]+/[^/]+)(/.*)?", path)
        files = self.server.repositories.get(found[1]) if found else None
        if found is None or files is None:
            self.answer(b"{}", 404, X_Error_Code="RepoNotFound", X_Error_Message="no such repository")
        elif (found[2] or "").startswith("/tree"):
            self.say([self.entry(name, content) for name, content in files.items()])
        else:
            siblings = [{"rfilename": name} for name in files]
            self.say({"id": found[1], "modelId": found[1], "sha": COMMIT, "siblings": siblings, "tags": []})

    do_HEAD = do_GET

    def entry(self, name: str, content: bytes) -> dict[str, object]:
        size = self.server.sizes.get(name, len(content))
        return {"type": "file", "path": name, "size": size, "oid": _digest(content)}

    def say(self, thing: object) -> None:
        self.answer(json.dumps(thing).encode(), Content_Type="application/json")

    def answer(self, content: bytes, status: int = 200, **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(content)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


def _digest(content: bytes) -> str:
    return hashlib.sha1(content).hexdigest()
