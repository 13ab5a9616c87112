"""The studio's web application: routes are short calls into the library. Starlette only here."""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from importlib import resources
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import BaseRoute, Mount, Route
from starlette.staticfiles import StaticFiles

from phytac_design.core.html import STYLE
from phytac_design.core.workers import WorkerPool
from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import parse_design, shipped_designs
from phytac_design.report.viewer.assets import SCRIPTS, style
from phytac_design.studio import request_bodies as bodies
from phytac_design.studio.build_process import BuildRunner
from phytac_design.studio.draft import draft, exact_in_worker
from phytac_design.studio.files import ConfirmationError, OpenedDesign, ProjectFolder
from phytac_design.studio.form import error_body, field_paths, form
from phytac_design.studio.latest_only import LatestOnlyExecutor, SupersededError
from phytac_design.studio.pressed_view import PressView
from phytac_design.studio.request_bodies import parse
from phytac_design.studio.studies import studies, study_table, trial_design
from phytac_design.study.advice.quick_repair import quick_repair
from phytac_shapes.errors import DesignError, InputError, OutputError, PhytacError

Json = dict[str, Any]
Handler = Callable[[Any], Awaitable[Json]]


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
        self.presses = LatestOnlyExecutor("press")
        self.pressed: PressView | None = None
        self.checker = WorkerPool(exact_in_worker, workers=1, retries=0)
        self.paths = field_paths()

    def app(self) -> Starlette:
        """ASGI application, without its guard."""
        get: dict[str, Callable[[Request], Awaitable[Response]]] = {
            "/": self.page,
            "/report.css": self.report_style,
            "/api/start": self.start,
            "/api/studies": self.studies,
            "/api/build": self.build_state,
            "/api/build/events": self.build_events,
            "/files/{path:path}": self.file,
        }
        post: dict[str, tuple[type[bodies.RequestBody], Handler]] = {
            "/api/open": (bodies.OpenRequest, self.open),
            "/api/draft": (bodies.DraftRequest, self.draft),
            "/api/press": (bodies.PressRequest, self.press),
            "/api/check": (bodies.CheckRequest, self.check),
            "/api/repair": (bodies.CheckRequest, self.repair),
            "/api/text": (bodies.DesignRequest, self.text),
            "/api/save": (bodies.SaveRequest, self.save),
            "/api/build": (bodies.BuildRequest, self.build),
            "/api/build/stop": (bodies.RequestBody, self.build_stop),
            "/api/study": (bodies.StudyRequest, self.study),
            "/api/trial": (bodies.TrialRequest, self.trial),
        }
        folder = resources.files("phytac_design")
        routes: list[BaseRoute] = [Route(path, handler) for path, handler in get.items()]
        routes += [Route(path, _posted(*each), methods=["POST"]) for path, each in post.items()]
        routes += [
            Mount("/static", StaticFiles(directory=str(folder / "studio" / "static"))),
            Mount("/viewer", StaticFiles(directory=str(folder / "report" / "viewer"))),
        ]

        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
            warm = asyncio.create_task(self._warm_up())
            yield
            warm.cancel()
            self.drafts.close()
            self.checks.close()
            self.presses.close()
            self.checker.close()
            await self.builds.stop()

        kinds = (SupersededError, PhytacError, HTTPException, ClientDisconnect, Exception)
        return Starlette(
            routes=routes, lifespan=lifespan, exception_handlers=dict.fromkeys(kinds, self.failure)
        )

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

    async def open(self, body: bodies.OpenRequest) -> Json:
        """Tables of a design."""
        return _opened(await run_in_threadpool(self.project.open, body.name))

    async def draft(self, body: bodies.DraftRequest) -> Json:
        """Layout, views, visibility and density, while controls move."""
        # A check would take half of the machine from a draft that supersedes it.
        self.checks.cancel(body.tab)
        drawn = await self.drafts.run(
            body.tab,
            lambda check: draft(
                self.project.design_of(body.data, body.source), check, body.side_px
            ),
        )
        return drawn | {"fields": error_body(drawn["refused"], self.paths)["fields"]}

    async def press(self, body: bodies.PressRequest) -> Json:
        """Camera views of a design under a press."""

        def work(check: Callable[[], None]) -> Json:
            design = self.project.design_of(body.data, body.source)
            view = self.pressed
            if view is None or (view.design, view.side_px) != (design, body.side_px):
                view = self.pressed = PressView(design=design, side_px=body.side_px)
            return view.draw(body.camera, np.array([body.x, body.y]), body.force_N, check)

        return await self.presses.run(body.tab, work)

    async def check(self, body: bodies.CheckRequest) -> Json:
        """`phytac check`, once controls rest; in a process of its own, so that drafts stay fast."""

        def work(_: Callable[[], None]) -> Json:
            design = self.project.design_of(body.data, body.source)
            (done,) = self.checker.run([design])
            if done.lost:  # the studio ends
                raise SupersededError
            found: Json = done.value
            return found

        return await self.checks.run(body.tab, work)

    async def repair(self, body: bodies.CheckRequest) -> Json:
        """A change after which the design passes the check; no words if none was found."""

        def work(check: Callable[[], None]) -> Json:
            design = self.project.design_of(body.data, body.source)
            found = quick_repair(design, progress=lambda _: check())
            return {"words": found.words, "fields": found.fields} if found else {"words": ""}

        return await self.checks.run(body.tab, work)

    async def text(self, body: bodies.DesignRequest) -> Json:
        """TOML of a design, as it would be saved."""

        def work() -> str:
            design = self.project.design_of(body.data, body.source)
            return self.project.text_of(body.data, design, body.source)

        return {"text": await run_in_threadpool(work)}

    async def save(self, body: bodies.SaveRequest) -> Json:
        """Write a design file."""
        opened = await run_in_threadpool(
            self.project.save,
            body.name,
            body.data,
            source=body.source,
            replace=body.replace,
            force=body.force,
        )
        return _opened(opened)

    async def build(self, body: bodies.BuildRequest) -> Json:
        """Start a build."""
        design = await run_in_threadpool(self.project.design_of, body.data, body.source)
        return await self.builds.start(design, body.accuracy, force=body.force)

    async def build_state(self, _: Request) -> Response:
        """State of the build."""
        return JSONResponse(self.builds.state())

    async def build_events(self, _: Request) -> Response:
        """Progress of the build, as server-sent events."""

        async def events() -> AsyncIterator[str]:
            async for state in self.builds.events():
                yield f"data: {json.dumps(state)}\n\n"

        return StreamingResponse(events(), media_type="text/event-stream")

    async def build_stop(self, _: bodies.RequestBody) -> Json:
        """Stop the build."""
        return await self.builds.stop()

    async def studies(self, _: Request) -> Response:
        """Studies of the project folder."""
        return JSONResponse({"studies": await run_in_threadpool(studies, self.project.root)})

    async def study(self, body: bodies.StudyRequest) -> Json:
        """Candidates of a study."""
        return await run_in_threadpool(study_table, self.project.within(body.folder))

    async def trial(self, body: bodies.TrialRequest) -> Json:
        """A candidate's design."""
        folder = self.project.within(body.folder)
        data = await run_in_threadpool(trial_design, folder, body.trial)
        return {"name": "", "data": data, "digest": ""}

    async def file(self, request: Request) -> Response:
        """A file of a build or a study that a browser may load, in a sandbox."""
        served = {".html", ".png", ".jpg", ".svg", ".json", ".csv", ".pdf", ".toml", ".md", ".txt"}
        path = self.project.within(request.path_params["path"])
        hidden = any(part.startswith(".") for part in path.relative_to(self.project.root).parts)
        if hidden or path.suffix not in served or not path.is_file():
            raise HTTPException(404, "no such file, or not a kind that a browser shows")
        # A report cannot send requests to the studio.
        sandbox = (
            "sandbox allow-scripts allow-popups; default-src 'unsafe-inline' data: blob:; "
            "frame-ancestors 'self'"
        )
        return FileResponse(path, headers={"Content-Security-Policy": sandbox})

    async def failure(self, request: Request, error: Exception) -> Response:
        """Status and text of the response to an error, without a traceback."""
        if isinstance(error, SupersededError):
            # Not a failure; a browser would log any other status on its console.
            return JSONResponse({"stale": True})
        if isinstance(error, ConfirmationError):
            return JSONResponse({"ask": str(error), "code": error.code}, 409)
        if isinstance(error, HTTPException):
            return JSONResponse({"error": error.detail}, error.status_code)
        if isinstance(error, PhytacError):
            kinds = {DesignError: 422, InputError: 400, OutputError: 409}
            status = next((n for kind, n in kinds.items() if isinstance(error, kind)), 422)
            body = {"code": error.code} | error_body(str(error), self.paths)
            return JSONResponse(body, status)
        if isinstance(error, ClientDisconnect):
            return Response(status_code=400)
        name = type(error).__name__
        print(f"studio: {request.url.path}: {name}: {error}", file=sys.stderr)
        text = f"this went wrong in the program ({name}); undo the last change, and report it"
        return JSONResponse({"error": text, "fields": {}}, 500)


def _posted(
    kind: type[bodies.RequestBody], handler: Handler
) -> Callable[[Request], Awaitable[Response]]:
    """Endpoint that parses a request's body and answers with JSON."""

    async def endpoint(request: Request) -> Response:
        return JSONResponse(await handler(parse(kind, await request.body())))

    return endpoint


def _opened(opened: OpenedDesign) -> Json:
    shipped = opened.name in shipped_designs()
    return {
        "name": opened.name,
        "data": opened.data,
        "digest": "" if shipped else opened.digest,
        "shipped": shipped,
    }
