"""The server of the page: on this machine only, for holders of the token, reading and writing one folder.

A request is answered if its Host and, if given, its Origin are this server, and its cookie holds the token of
the printed address. Pages may load nothing from elsewhere.
"""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from cpam_bayes.workbench.view import begin_page, folder_news, news_of, visit_page
from cpam_bayes.workbench.visit import MOST_BYTES, Desk, EditError, Visit, Work, plate_names

HOST: Final = "127.0.0.1"
_MOST_BYTES, _MOST_VISITS = 64_000, 100
_WAIT = 25.0
_RESULTS: Final = {
    "json": "application/json",
    "xlsx": "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
}
_FILES: Final = {"app.css": "text/css", "app.js": "text/javascript"}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
# A report embeds its style and figures, and has no script.
_REPORT_POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; frame-ancestors 'none'"


class _Refused(Exception):
    """A request refused with this status and sentence."""

    def __init__(self, status: int, said: str) -> None:
        super().__init__(status, said)


class _Guard:
    """Admits requests of the page itself; all others get an error."""

    def __init__(self, app: Any, hosts: frozenset[str], token: str, cookie: str, pages: _Pages) -> None:
        self.app, self.hosts, self.token, self.cookie, self.pages = app, hosts, token, cookie, pages

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return
        request = Request(scope)
        said = self._refusal(request)
        if said is not None:
            await _with_headers(PlainTextResponse(said, 403))(scope, receive, send)
            return
        await self.app(scope, receive, send)

    def _refusal(self, request: Request) -> str | None:
        headers = request.headers
        if headers.get("host", "") not in self.hosts or len(headers.getlist("host")) != 1:
            return "refused: this page belongs to another address"
        origins = headers.getlist("origin")
        if any(origin.removeprefix("http://") not in self.hosts for origin in origins):
            return "refused: asked for by another page"
        if headers.get("sec-fetch-site", "none") not in ("none", "same-origin"):
            return "refused: asked for by another page"
        if request.method != "GET" and not origins:
            return "refused: not asked for by the page"
        given = request.cookies.get(self.cookie) or ""
        if request.url.path == "/" and "token" in request.query_params:
            given = request.query_params["token"]
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return "refused: open the address that cpam-bayes app printed"
        return None


def _with_headers(response: Response) -> Response:
    for name, value in _HEADERS.items():
        response.headers.setdefault(name, value)
    return response


class _Pages:
    """Handlers of the admitted requests."""

    def __init__(self, desk: Desk, token: str, cookie: str, first: Callable[[], Visit] | None) -> None:
        self.desk, self.token, self.cookie, self.first = desk, token, cookie, first
        self.visits: dict[str, Visit] = {}
        self.list = Work(desk=desk, file="batch")

    def wake(self) -> None:
        """Answer all requests that wait for news."""
        for work in (self.list, *self.visits.values()):
            work.tell()

    def stop(self) -> None:
        """End all computations."""
        for work in (self.list, *self.visits.values()):
            work.stop()
        self.desk.live.stop()
        self.desk.pool.stop()

    def _visit(self, request: Request) -> Visit:
        key = str(request.path_params["visit"])
        found = self.visits.get(key)
        if found is None:
            try:
                found = self._added(Visit.restored(self.desk, key))
            except EditError as error:
                raise _Refused(404, str(error)) from None
        return found

    def _added(self, visit: Visit) -> Visit:
        for key in list(self.visits)[: max(0, len(self.visits) - _MOST_VISITS + 1)]:
            self.visits.pop(key).stop()
        self.visits[visit.key] = visit
        visit.keep()
        visit.begin()
        return visit

    async def begin(self, request: Request) -> Response:
        """The first page; an address with the token sets its cookie and redirects."""
        if "token" in request.query_params:
            response: Response = RedirectResponse("/", 303)
            response.set_cookie(self.cookie, self.token, httponly=True, samesite="strict")
            return response
        if self.first is not None:
            visit, self.first = self._added(self.first()), None
            return RedirectResponse(f"/visit/{visit.key}", 303)
        return HTMLResponse(begin_page(self.desk.folder, plate_names(self.desk.folder), self.list))

    async def folder_news(self, request: Request) -> Response:
        """Changes of the list of plates, once there are any."""
        await self.list.news(_number(request, "seen"), _WAIT)
        return JSONResponse(folder_news(plate_names(self.desk.folder), self.list))

    async def folder_act(self, request: Request) -> Response:
        """Start or end the computation of the table of all plates in the folder."""
        asked, names = await _body(request), plate_names(self.desk.folder)
        if asked.get("do") == "cancel":
            self.list.cancel()
        elif asked.get("do") == "batch" and names:
            self.list.text, self.list.problems = "\n".join(names), ()
            self.list.begin_task("batch")
        else:
            raise EditError(f"do: received {asked.get('do')!r:.60}, accepted: batch cancel")
        return JSONResponse({"said": "", **folder_news(names, self.list)})

    async def folder_report(self, request: Request) -> Response:
        """The page of the last computed table of plates."""
        return self._page_of(self.list.answers.get("batch"))

    async def open(self, request: Request) -> Response:
        """A new visit: of a file, an empty plate or the example."""
        asked = await _body(request)
        if asked.get("file") is not None:
            visit = Visit.opened(self.desk, asked["file"])
        elif asked.get("example"):
            visit = Visit.opened(self.desk, "example.toml", self.desk.example)
        else:
            visit = Visit.opened(self.desk, "plate.toml", self.desk.blank)
        return JSONResponse({"go": f"/visit/{self._added(visit).key}"})

    async def page(self, request: Request) -> Response:
        """The page of a visit."""
        return HTMLResponse(visit_page(self._visit(request)))

    async def news(self, request: Request) -> Response:
        """Changes since a version, once there are any."""
        visit = self._visit(request)
        await visit.news(_number(request, "seen"), _WAIT)
        return JSONResponse(news_of(visit, _number(request, "structure")))

    async def edit(self, request: Request) -> Response:
        """Make one edit."""
        visit, asked = self._visit(request), await _body(request)
        visit.edit(asked)
        known = asked.get("structure")
        return JSONResponse(news_of(visit, known if isinstance(known, int) else -1))

    async def act(self, request: Request) -> Response:
        """Save, cancel, or compute on request."""
        visit, asked = self._visit(request), await _body(request)
        said, what = "", asked.get("do")
        if what == "save":
            said = visit.save(asked.get("name", visit.file))
        elif what == "cancel":
            visit.cancel()
        elif what in ("diagnose", "report", "identify"):
            visit.ask(str(what))
        else:
            raise EditError(f"do: received {what!r:.60}, accepted: save cancel identify diagnose report")
        return JSONResponse({"said": said, **news_of(visit, -1 if said else visit.structure)})

    async def plate_file(self, request: Request) -> Response:
        """The current plate file."""
        return PlainTextResponse(self._visit(request).text)

    async def drop(self, request: Request) -> Response:
        """Take a file dropped on the page."""
        visit = self._visit(request)
        content = await _content(request, "application/octet-stream", MOST_BYTES)
        said = visit.take(request.query_params.get("name", ""), content)
        return JSONResponse({"said": said, **news_of(visit, -1)})

    async def report(self, request: Request) -> Response:
        """The last written report."""
        visit = self._visit(request)
        return self._page_of(visit.answers.get("report", visit.stale.get("report")))

    def _page_of(self, written: Mapping[str, Any] | None) -> Response:
        response = HTMLResponse(self._written(written, "page").decode())
        response.headers["Content-Security-Policy"] = _REPORT_POLICY
        return response

    def _written(self, written: Mapping[str, Any] | None, kind: str) -> bytes:
        """The content of a written file of an answer."""
        path = None if written is None else self.desk.folder / str(written[kind])
        if path is None or not path.is_file() or path.is_symlink():
            raise _Refused(404, "no report has been written")
        return bytes(path.read_bytes())

    async def results(self, request: Request) -> Response:
        """The last report as JSON or as a workbook."""
        visit, kind = self._visit(request), str(request.path_params["kind"])
        if kind not in _RESULTS:
            raise _Refused(404, "no such file")
        content = self._written(visit.answers.get("report", visit.stale.get("report")), kind)
        name = f'attachment; filename="{Path(visit.file).stem}.{kind}"'
        return Response(content, media_type=_RESULTS[kind], headers={"Content-Disposition": name})

    async def file(self, request: Request) -> Response:
        """The style sheet or the script."""
        name = str(request.path_params["name"])
        if name not in _FILES:
            raise _Refused(404, "no such file")
        return Response((Path(__file__).parent / "pages" / name).read_bytes(), media_type=_FILES[name])


def _number(request: Request, name: str) -> int:
    given = request.query_params.get(name, "-1")
    return int(given) if given.isascii() and given.isdigit() and len(given) < 10 else -1


async def _content(request: Request, kind: str, most: int) -> bytes:
    """The body of a request, of one media type and limited size."""
    if request.headers.get("content-type", "").partition(";")[0] != kind:
        raise _Refused(415, f"accepted: {kind}")
    content = bytearray()
    async for chunk in request.stream():
        content += chunk
        if len(content) > most:
            raise _Refused(413, f"accepted: up to {most} bytes")
    return bytes(content)


async def _body(request: Request) -> Mapping[str, Any]:
    """The JSON object in a request, 64 kB at most."""
    try:
        asked = json.loads(await _content(request, "application/json", _MOST_BYTES))
    except (ValueError, RecursionError):
        raise _Refused(400, "accepted: JSON") from None
    if not isinstance(asked, dict):
        raise _Refused(400, "accepted: a JSON object")
    return asked


def application(desk: Desk, token: str, port: int, first: Callable[[], Visit] | None = None) -> Any:
    """The application; token : required in the address, first : makes the visit that is shown first."""
    cookie = f"cpam_bayes_{port}"
    pages = _Pages(desk, token, cookie, first)

    async def refused(request: Request, error: Exception) -> Response:
        status, said = error.args if isinstance(error, _Refused) else (400, str(error))
        return _with_headers(JSONResponse({"error": said}, status))

    async def failed(request: Request, error: Exception) -> Response:
        return JSONResponse({"error": "the page has an error; reload it, nothing is lost"}, 500)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        yield
        pages.stop()

    def route(path: str, answer: Callable[[Request], Awaitable[Response]], method: str = "GET") -> Route:
        async def endpoint(request: Request) -> Response:
            return _with_headers(await answer(request))

        return Route(path, endpoint, methods=[method])

    app = Starlette(
        routes=[
            route("/", pages.begin),
            route("/file/{name}", pages.file),
            route("/open", pages.open, "POST"),
            route("/folder/news", pages.folder_news),
            route("/folder/act", pages.folder_act, "POST"),
            route("/folder/report", pages.folder_report),
            route("/visit/{visit}", pages.page),
            route("/visit/{visit}/news", pages.news),
            route("/visit/{visit}/plate.toml", pages.plate_file),
            route("/visit/{visit}/report", pages.report),
            route("/visit/{visit}/results.{kind}", pages.results),
            route("/visit/{visit}/file", pages.drop, "POST"),
            route("/visit/{visit}/edit", pages.edit, "POST"),
            route("/visit/{visit}/act", pages.act, "POST"),
        ],
        exception_handlers={_Refused: refused, EditError: refused, Exception: failed},
        lifespan=lifespan,
    )
    return _Guard(app, frozenset({f"{HOST}:{port}", f"localhost:{port}"}), token, cookie, pages)


def free_port(port: int) -> int:
    """The port, or a free one for 0; raises ``ValueError`` where it is taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise ValueError(
                f"--port: received {port}, {error.strerror}; give another one, or 0 for any that is free"
            ) from None
        return int(probe.getsockname()[1])


def serve(desk: Desk, port: int, announce: Callable[[str], None], first: Callable[[], Visit] | None) -> None:
    """Serve the page until Ctrl-C; announce : called once with its address."""
    import uvicorn

    token = secrets.token_urlsafe(24)
    app = application(desk, token, port, first)
    config = uvicorn.Config(
        app,
        host=HOST,
        port=port,
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )

    class Announcing(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            announce(f"http://{HOST}:{port}/?token={token}")

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            app.pages.wake()
            await super().shutdown(sockets)

    try:
        Announcing(config).run()
    except KeyboardInterrupt:
        pass
    finally:
        app.pages.stop()
