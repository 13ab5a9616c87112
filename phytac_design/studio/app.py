"""The studio's web application: each route a short call into the library. Starlette only here."""

import asyncio
import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from importlib import resources
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from phytac_design.design.accuracy import PRESETS
from phytac_design.design.design_file import shipped_designs
from phytac_design.report.page import STYLE
from phytac_design.report.viewer.assets import SCRIPTS, style, text_of
from phytac_design.studio import request_bodies as ask
from phytac_design.studio.access_control import RefusedError
from phytac_design.studio.builds import Builds
from phytac_design.studio.draft import Asked, draft, exact
from phytac_design.studio.errors import error_body
from phytac_design.studio.files import AskError, Opened, ProjectFolder
from phytac_design.studio.form import field_paths, form
from phytac_design.studio.latest_only import StaleError, Turns
from phytac_design.studio.studies import studies, study_table, trial_design
from phytac_shapes.errors import DesignError, InputError, OutputError, PhytacError

STATIC = {
    "html": "text/html",
    "css": "text/css",
    "js": "text/javascript",
    "svg": "image/svg+xml",
}
SHOWN = {".html", ".png", ".jpg", ".svg", ".json", ".csv", ".pdf", ".toml", ".md", ".txt"}
"""Endings of files of builds and studies that a browser may be shown."""
SANDBOX = (
    "sandbox allow-scripts allow-popups; default-src 'unsafe-inline' data: blob:; "
    "frame-ancestors 'self'"
)
"""A report is a page of its own: it cannot ask the studio for anything."""

Json = dict[str, Any]
Answer = Callable[[Request], Awaitable[Response]]


class Studio:
    """Routes over one workplace.

    Parameters
    ----------
    place : Workplace
        Where designs are.
    design : str
        What is open at first: a shipped design, or a path.
    """

    def __init__(self, place: ProjectFolder, design: str) -> None:
        self.place, self.design = place, design
        self.builds = Builds(place.root)
        self.drafts, self.checks = Turns("draft"), Turns("check")
        self.paths = field_paths()

    def app(self) -> Starlette:
        """ASGI application, without its guard."""
        get: dict[str, Answer] = {
            "/": self.page,
            "/report.css": self.look,
            "/static/{name}": self.static,
            "/viewer/{name}": self.viewer,
            "/api/start": self.start,
            "/api/studies": self.studies,
            "/api/build": self.build_state,
            "/api/build/events": self.build_events,
            "/files/{path:path}": self.file,
        }
        post: dict[str, Answer] = {
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
        routes = [Route(path, told(answer, self.paths)) for path, answer in get.items()]
        routes += [
            Route(path, told(answer, self.paths), methods=["POST"]) for path, answer in post.items()
        ]

        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncIterator[None]:
            warm = asyncio.create_task(self._warm_up())
            yield
            warm.cancel()
            await self.close()

        return Starlette(routes=routes, lifespan=lifespan)

    async def _warm_up(self) -> None:
        """Load compiled loops before the first control is moved."""
        try:
            opened = await run_in_threadpool(self.place.open, "cylinder60")
            here = Asked(data=opened.data, folder=opened.folder)
            await self.drafts.run("warm-up", lambda turn: draft(here, turn.check))
        except (PhytacError, StaleError, RuntimeError):
            return

    async def close(self) -> None:
        """End what was started."""
        self.drafts.close()
        self.checks.close()
        await self.builds.stop()

    async def page(self, _: Request) -> Response:
        """The page, with the scripts of the turnable view."""
        path = resources.files("phytac_design.studio") / "static" / "index.html"
        tags = "".join(f'<script src="viewer/{name}"></script>\n' for name in SCRIPTS)
        text = path.read_text(encoding="utf-8").replace("<!--viewer-->\n", tags)
        return Response(text, media_type="text/html")

    async def look(self, _: Request) -> Response:
        """The report's style."""
        return Response(STYLE + style(), media_type="text/css")

    async def static(self, request: Request) -> Response:
        """A part of the page."""
        return _static(request.path_params["name"])

    async def viewer(self, request: Request) -> Response:
        """A part of the turnable view, which the report has too."""
        name = request.path_params["name"]
        if name not in SCRIPTS:
            raise RefusedError(404, "no such part of the page")
        return Response(text_of(name), media_type="text/javascript")

    async def start(self, _: Request) -> Response:
        """Everything that the page needs once."""
        opened = await run_in_threadpool(self.place.open, self.design)
        files = await run_in_threadpool(self.place.designs)
        return JSONResponse(
            {
                "form": form(),
                "shipped": shipped_designs(),
                "files": files,
                "root": str(self.place.root),
                "accuracies": list(PRESETS),
                "design": _opened(opened),
                "build": self.builds.state(),
            }
        )

    async def open(self, request: Request) -> Response:
        """Tables of a design."""
        asked = ask.parse(ask.OpenRequest, await request.body())
        return JSONResponse(_opened(await run_in_threadpool(self.place.open, asked.name)))

    async def draft(self, request: Request) -> Response:
        """Layout, views, visibility and density, while controls move."""
        asked = ask.parse(ask.DraftRequest, await request.body())
        # A check would take half of the machine from a draft that has just replaced it.
        self.checks.cancel(asked.tab)
        folder = self.place.folder_of(asked.source)
        here = Asked(data=asked.data, folder=folder, side_px=asked.side_px)
        drawn = await self.drafts.run(asked.tab, lambda turn: draft(here, turn.check))
        fields = error_body(drawn["refused"], self.paths)["fields"]
        return JSONResponse(drawn | {"fields": fields})

    async def check(self, request: Request) -> Response:
        """`phytac check`, once controls rest."""
        asked = ask.parse(ask.ExactRequest, await request.body())
        here = Asked(data=asked.data, folder=self.place.folder_of(asked.source))
        return JSONResponse(await self.checks.run(asked.tab, lambda _: exact(here)))

    async def text(self, request: Request) -> Response:
        """TOML of a design, as it would be saved."""
        asked = ask.parse(ask.DesignRequest, await request.body())
        folder = self.place.folder_of(asked.source)

        def work() -> str:
            design = Asked(data=asked.data, folder=folder).design()
            return self.place.text_of(asked.data, design, asked.source)

        return JSONResponse({"text": await run_in_threadpool(work)})

    async def save(self, request: Request) -> Response:
        """Write a design file."""
        asked = ask.parse(ask.SaveRequest, await request.body())
        opened = await run_in_threadpool(
            self.place.save,
            asked.name,
            asked.data,
            source=asked.source,
            replace=asked.replace,
            force=asked.force,
        )
        return JSONResponse(_opened(opened))

    async def build(self, request: Request) -> Response:
        """Start a build."""
        asked = ask.parse(ask.BuildRequest, await request.body())
        here = Asked(data=asked.data, folder=self.place.folder_of(asked.source))
        design = await run_in_threadpool(here.design)
        return JSONResponse(
            await self.builds.start(design, asked.accuracy, force=asked.force), status_code=202
        )

    async def build_state(self, _: Request) -> Response:
        """Where the build stands."""
        return JSONResponse(self.builds.state())

    async def build_events(self, _: Request) -> Response:
        """The build's progress, as server-sent events."""

        async def events() -> AsyncIterator[str]:
            async for state in self.builds.events():
                yield f"data: {json.dumps(state)}\n\n"

        return StreamingResponse(events(), media_type="text/event-stream")

    async def build_stop(self, request: Request) -> Response:
        """End the build."""
        ask.parse(ask.NoRequest, await request.body())
        return JSONResponse(await self.builds.stop())

    async def studies(self, _: Request) -> Response:
        """Studies of the workplace."""
        return JSONResponse({"studies": await run_in_threadpool(studies, self.place.root)})

    async def study(self, request: Request) -> Response:
        """Candidates of a study."""
        asked = ask.parse(ask.StudyRequest, await request.body())
        folder = self.place.within(asked.folder)
        return JSONResponse(await run_in_threadpool(study_table, folder))

    async def trial(self, request: Request) -> Response:
        """A candidate's design."""
        asked = ask.parse(ask.TrialRequest, await request.body())
        folder = self.place.within(asked.folder)
        data = await run_in_threadpool(trial_design, folder, asked.trial)
        return JSONResponse({"name": "", "data": data, "digest": ""})

    async def file(self, request: Request) -> Response:
        """A file of a build or a study, shut off from the studio."""
        path = self.place.within(request.path_params["path"])
        hidden = any(part.startswith(".") for part in path.relative_to(self.place.root).parts)
        if hidden or path.suffix not in SHOWN or not path.is_file():
            raise RefusedError(404, "no such file, or none that a browser shows")
        return FileResponse(path, headers={"Content-Security-Policy": SANDBOX})


def _opened(opened: Opened) -> Json:
    shipped = opened.name in shipped_designs()
    return {
        "name": opened.name,
        "data": opened.data,
        "digest": "" if shipped else opened.digest,
        "shipped": shipped,
    }


def _static(name: str) -> Response:
    path = resources.files("phytac_design.studio") / "static" / name
    kind = STATIC.get(name.rsplit(".", 1)[-1])
    if kind is None or "/" in name or not path.is_file():
        raise RefusedError(404, "no such part of the page")
    return Response(path.read_bytes(), media_type=kind)


def told(answer: Answer, paths: list[str]) -> Answer:
    """Let ``answer`` fail with a clear text and a status, never with a traceback."""

    async def safe(request: Request) -> Response:
        try:
            return await answer(request)
        except ClientDisconnect:
            return Response(status_code=400)
        except Exception as error:  # noqa: BLE001 - whatever it is, the studio lives on
            status, body = failure(error, paths)
            if status == SURPRISE:
                name = type(error).__name__
                print(f"studio: {request.url.path}: {name}: {error}", file=sys.stderr)
            return JSONResponse(body, status_code=status)

    return safe


STATUS: dict[type[PhytacError], int] = {DesignError: 422, InputError: 400, OutputError: 409}
SURPRISE = 500


def failure(error: Exception, paths: list[str]) -> tuple[int, Json]:
    """Status and body of an answer that could not be given."""
    if isinstance(error, StaleError):
        # Nothing went wrong, and a browser would write any other status on its console.
        return 200, {"stale": True}
    if isinstance(error, AskError):
        return 409, {"ask": str(error)}
    if isinstance(error, RefusedError):
        return error.status, {"error": str(error)}
    if isinstance(error, PhytacError):
        status = next((n for kind, n in STATUS.items() if isinstance(error, kind)), 422)
        return status, error_body(str(error), paths)
    name = type(error).__name__
    text = f"this went wrong in the program ({name}); undo the last change, and report it"
    return SURPRISE, {"error": text, "fields": {}}
