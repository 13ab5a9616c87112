"""The studio's web application: routes are short calls into the library. Starlette only here."""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from importlib import resources
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from phytac_design.core.html import STYLE
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import parse_design, shipped_designs
from phytac_design.report.viewer.assets import SCRIPTS, style, text_of
from phytac_design.studio import request_bodies as bodies
from phytac_design.studio.access_control import RejectedError
from phytac_design.studio.build_process import BuildRunner
from phytac_design.studio.draft import draft, exact
from phytac_design.studio.files import ConfirmationError, OpenedDesign, ProjectFolder
from phytac_design.studio.form import error_body, field_paths, form
from phytac_design.studio.latest_only import LatestOnlyExecutor, SupersededError
from phytac_design.studio.request_bodies import parse
from phytac_design.studio.studies import studies, study_table, trial_design
from phytac_shapes.errors import DesignError, InputError, OutputError, PhytacError

STATIC_TYPES = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
SERVED = {".html", ".png", ".jpg", ".svg", ".json", ".csv", ".pdf", ".toml", ".md", ".txt"}
"""Endings of files of builds and studies that a browser may load."""
SANDBOX = (
    "sandbox allow-scripts allow-popups; default-src 'unsafe-inline' data: blob:; "
    "frame-ancestors 'self'"
)
"""Policy of served files: a report cannot send requests to the studio."""
STATUS: dict[type[PhytacError], int] = {DesignError: 422, InputError: 400, OutputError: 409}
INTERNAL_ERROR = 500

Json = dict[str, Any]
Handler = Callable[[Request], Awaitable[Response]]


class Studio:
    """Routes over one project folder.

    Parameters
    ----------
    project : ProjectFolder
        Where designs are.
    design : str
        The design to open first: a shipped one, or a path.
    """

    def __init__(self, project: ProjectFolder, design: str) -> None:
        self.project, self.design = project, design
        self.builds = BuildRunner(project.root)
        self.drafts, self.checks = LatestOnlyExecutor("draft"), LatestOnlyExecutor("check")
        self.paths = field_paths()

    def app(self) -> Starlette:
        """ASGI application, without its guard."""
        get: dict[str, Handler] = {
            "/": self.page,
            "/report.css": self.report_style,
            "/static/{name}": self.static,
            "/viewer/{name}": self.viewer,
            "/api/start": self.start,
            "/api/studies": self.studies,
            "/api/build": self.build_state,
            "/api/build/events": self.build_events,
            "/files/{path:path}": self.file,
        }
        post: dict[str, Handler] = {
            "/api/open": self.open,
            "/api/draft": self.draft,
            "/api/check": self.check,
            "/api/text": self.text,
            "/api/save": self.save,
            "/api/build": self.build,
            "/api/build/stop": self.build_stop,
            "/api/study": self.study,
            "/api/trial": self.trial,
        }
        routes = [
            Route(path, handle_errors(handler, self.paths), methods=[method])
            for method, handlers in (("GET", get), ("POST", post))
            for path, handler in handlers.items()
        ]

        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
            warm = asyncio.create_task(self._warm_up())
            yield
            warm.cancel()
            self.drafts.close()
            self.checks.close()
            await self.builds.stop()

        return Starlette(routes=routes, lifespan=lifespan)

    async def _warm_up(self) -> None:
        """Load compiled loops before the first control is moved."""
        with suppress(PhytacError, SupersededError, RuntimeError):
            data = (await run_in_threadpool(self.project.open, "cylinder60")).data
            await self.drafts.run("warm-up", lambda check: draft(parse_design(data, ""), check))

    async def page(self, _: Request) -> Response:
        """The page, with the scripts of the 3-D view."""
        path = resources.files("phytac_design.studio") / "static" / "index.html"
        tags = "".join(f'<script src="viewer/{name}"></script>\n' for name in SCRIPTS)
        text = path.read_text(encoding="utf-8").replace("<!--viewer-->\n", tags)
        return Response(text, media_type="text/html")

    async def report_style(self, _: Request) -> Response:
        """The report's style sheet."""
        return Response(STYLE + style(), media_type="text/css")

    async def static(self, request: Request) -> Response:
        """A file of the page."""
        name = request.path_params["name"]
        path = resources.files("phytac_design.studio") / "static" / name
        kind = STATIC_TYPES.get(name.rsplit(".", 1)[-1])
        if kind is None or "/" in name or not path.is_file():
            raise RejectedError(404, "no such part of the page")
        return Response(path.read_bytes(), media_type=kind)

    async def viewer(self, request: Request) -> Response:
        """A script of the 3-D view, which the report uses too."""
        name = request.path_params["name"]
        if name not in SCRIPTS:
            raise RejectedError(404, "no such part of the page")
        return Response(text_of(name), media_type="text/javascript")

    async def start(self, _: Request) -> Response:
        """Everything that the page needs once."""
        opened = await run_in_threadpool(self.project.open, self.design)
        return JSONResponse(
            {
                "form": form(),
                "shipped": shipped_designs(),
                "files": await run_in_threadpool(self.project.designs),
                "root": str(self.project.root),
                "accuracies": list(PRESETS),
                "design": _opened(opened),
                "build": self.builds.state(),
            }
        )

    async def open(self, request: Request) -> Response:
        """Tables of a design."""
        body = parse(bodies.OpenRequest, await request.body())
        return JSONResponse(_opened(await run_in_threadpool(self.project.open, body.name)))

    async def draft(self, request: Request) -> Response:
        """Layout, views, visibility and density, while controls move."""
        body = parse(bodies.DraftRequest, await request.body())
        # A check would take half of the machine from a draft that supersedes it.
        self.checks.cancel(body.tab)
        drawn = await self.drafts.run(
            body.tab,
            lambda check: draft(
                self.project.design_of(body.data, body.source), check, body.side_px
            ),
        )
        fields = error_body(drawn["refused"], self.paths)["fields"]
        return JSONResponse(drawn | {"fields": fields})

    async def check(self, request: Request) -> Response:
        """`phytac check`, once controls rest."""
        body = parse(bodies.CheckRequest, await request.body())
        checked = await self.checks.run(
            body.tab, lambda _: exact(self.project.design_of(body.data, body.source))
        )
        return JSONResponse(checked)

    async def text(self, request: Request) -> Response:
        """TOML of a design, as it would be saved."""
        body = parse(bodies.DesignRequest, await request.body())

        def work() -> str:
            design = self.project.design_of(body.data, body.source)
            return self.project.text_of(body.data, design, body.source)

        return JSONResponse({"text": await run_in_threadpool(work)})

    async def save(self, request: Request) -> Response:
        """Write a design file."""
        body = parse(bodies.SaveRequest, await request.body())
        opened = await run_in_threadpool(
            self.project.save,
            body.name,
            body.data,
            source=body.source,
            replace=body.replace,
            force=body.force,
        )
        return JSONResponse(_opened(opened))

    async def build(self, request: Request) -> Response:
        """Start a build."""
        body = parse(bodies.BuildRequest, await request.body())
        design = await run_in_threadpool(self.project.design_of, body.data, body.source)
        state = await self.builds.start(design, body.accuracy, force=body.force)
        return JSONResponse(state, status_code=202)

    async def build_state(self, _: Request) -> Response:
        """State of the build."""
        return JSONResponse(self.builds.state())

    async def build_events(self, _: Request) -> Response:
        """Progress of the build, as server-sent events."""

        async def events() -> AsyncIterator[str]:
            async for state in self.builds.events():
                yield f"data: {json.dumps(state)}\n\n"

        return StreamingResponse(events(), media_type="text/event-stream")

    async def build_stop(self, request: Request) -> Response:
        """Stop the build."""
        parse(bodies.RequestBody, await request.body())
        return JSONResponse(await self.builds.stop())

    async def studies(self, _: Request) -> Response:
        """Studies of the project folder."""
        return JSONResponse({"studies": await run_in_threadpool(studies, self.project.root)})

    async def study(self, request: Request) -> Response:
        """Candidates of a study."""
        body = parse(bodies.StudyRequest, await request.body())
        folder = self.project.within(body.folder)
        return JSONResponse(await run_in_threadpool(study_table, folder))

    async def trial(self, request: Request) -> Response:
        """A candidate's design."""
        body = parse(bodies.TrialRequest, await request.body())
        folder = self.project.within(body.folder)
        data = await run_in_threadpool(trial_design, folder, body.trial)
        return JSONResponse({"name": "", "data": data, "digest": ""})

    async def file(self, request: Request) -> Response:
        """A file of a build or a study, in a sandbox."""
        path = self.project.within(request.path_params["path"])
        hidden = any(part.startswith(".") for part in path.relative_to(self.project.root).parts)
        if hidden or path.suffix not in SERVED or not path.is_file():
            raise RejectedError(404, "no such file, or not a kind that a browser shows")
        return FileResponse(path, headers={"Content-Security-Policy": SANDBOX})


def _opened(opened: OpenedDesign) -> Json:
    shipped = opened.name in shipped_designs()
    return {
        "name": opened.name,
        "data": opened.data,
        "digest": "" if shipped else opened.digest,
        "shipped": shipped,
    }


def handle_errors(handler: Handler, paths: list[str]) -> Handler:
    """Handler that turns errors into a status and a text without a traceback."""

    async def safe(request: Request) -> Response:
        try:
            return await handler(request)
        except ClientDisconnect:
            return Response(status_code=400)
        except Exception as error:  # noqa: BLE001 - the studio keeps running
            status, body = failure(error, paths)
            if status == INTERNAL_ERROR:
                name = type(error).__name__
                print(f"studio: {request.url.path}: {name}: {error}", file=sys.stderr)
            return JSONResponse(body, status_code=status)

    return safe


def failure(error: Exception, paths: list[str]) -> tuple[int, Json]:
    """Status and body of the response to an error."""
    if isinstance(error, SupersededError):
        # Not a failure; a browser would log any other status on its console.
        return 200, {"stale": True}
    if isinstance(error, ConfirmationError):
        return 409, {"ask": str(error)}
    if isinstance(error, RejectedError):
        return error.status, {"error": str(error)}
    if isinstance(error, PhytacError):
        status = next((n for kind, n in STATUS.items() if isinstance(error, kind)), 422)
        return status, error_body(str(error), paths)
    name = type(error).__name__
    text = f"this went wrong in the program ({name}); undo the last change, and report it"
    return INTERNAL_ERROR, {"error": text, "fields": {}}
