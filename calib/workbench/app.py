"""What the page may ask: addresses of the server, each answered from the results as they are."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from functools import partial
from importlib import resources
from typing import Any, TypeVar

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute

from calib.errors.errors import InputError
from calib.execution.outcome import words_of
from calib.execution.tasks import one_thread
from calib.report.html import space
from calib.report.html.study_results import StudyResults
from calib.results.results import json_value
from calib.study.study_file import StudyFile
from calib.workbench.correlation import correlation_view
from calib.workbench.designs import designs_view
from calib.workbench.edits import Edits
from calib.workbench.evaluators import Evaluators
from calib.workbench.live import Live
from calib.workbench.measurement import measurement
from calib.workbench.missing import missing, uncalibrated, versions
from calib.workbench.overview import listed, overview
from calib.workbench.parameters import parameters
from calib.workbench.runs import KINDS, OPTIONS, Commands, adding, new_study
from calib.workbench.search import LedgerReader
from calib.workbench.search_view import search_view
from calib.workbench.studies import KnownStudy, Studies, stamp_of

T = TypeVar("T")
_KINDS = {
    "html": "text/html; charset=utf-8", "css": "text/css; charset=utf-8", "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml", "data": "application/json",
}  # fmt: skip
_OF_REPORT = ("three.min.js", "viewer.js")
"""Files of the report that the page uses as they are."""
_REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "sandbox allow-scripts allow-downloads"
)
"""The report is one file with its scripts in it: it is shown in an origin of its own, which may ask for nothing."""


class Workbench:
    """The server's answers.

    Parameters
    ----------
    studies : Studies
    """

    def __init__(self, studies: Studies):
        self.studies = studies
        self.commands = Commands()
        self.edits = Edits()
        self.evaluators = Evaluators()
        self.live = Live(studies, self.commands)
        self._ledgers: dict[str, LedgerReader] = {}
        self._drawing, self._reading = threading.Lock(), threading.Lock()
        self._designs_known: tuple[Any, bytes] = None, b""
        self._drawn: dict[tuple[str, ...], tuple[str, str]] = {}
        self._files = _files()

    @property
    def app(self) -> Starlette:
        """The application, whose paths follow the token."""
        read: dict[str, Callable[[Request], Any]] = {
            "": self._overview, "search": self._search, "missing": self._missing, "versions": self._versions,
            "scene": self._scene, "correlation": self._correlation, "parameters": self._parameters,
            "what-if": self._what_if, "measurement": self._measurement,
        }  # fmt: skip
        change: dict[str, Callable[[Request, Mapping[str, Any]], Any]] = {
            "run": self._run, "stop": self._stop, "add": self._add, "edit": self._edit,
            "undo": self._undo, "evaluate": self._evaluate,
        }  # fmt: skip
        asked = [Route(f"/study/{{key}}/{name}".rstrip("/"), partial(self._read, own)) for name, own in read.items()]
        changed = [
            Route(f"/study/{{key}}/{name}", partial(self._change, own), methods=["POST"])
            for name, own in change.items()
        ]
        return Starlette(
            routes=[
                Route("/", self._file), Route("/page/{name}", self._file),
                Route("/studies", partial(self._read, self._all)),
                Route("/new", partial(self._change, self._new), methods=["POST"]),
                Route("/study/{key}/figure/{figure}", self._figure), Route("/study/{key}/report", self._report),
                Route("/study/{key}/designs", self._designs),
                *asked, *changed, WebSocketRoute("/live", self.live.serve),
            ],
        )  # fmt: skip

    # -- answers -------------------------------------------------------------------------------------------------------

    def _study(self, request: Request) -> KnownStudy:
        study = self.studies.one(request.path_params["key"])
        if study is None:
            raise LookupError("there is no such study below the folder")
        return study

    async def _read(self, ask: Callable[[Request], Any], request: Request) -> Response:
        return await _answered(partial(ask, request))

    async def _change(self, change: Callable[[Request, Mapping[str, Any]], Any], request: Request) -> Response:
        try:
            given = json.loads(await request.body() or b"{}")
        except (ValueError, RecursionError):
            given = None
        if not isinstance(given, dict):
            return _told({"fault": "the request is no JSON object"}, 400)
        found = await _answered(partial(change, request, given))
        if change != self._evaluate:  # which changes nothing
            self.live.look()
        return found

    def _all(self, request: Request) -> Any:
        known = self.studies.all()
        found = []
        for one in known.values():
            try:
                found.append(listed(self.studies, one, known))
            except InputError as fault:
                found.append({"key": one.key, "name": one.name, "path": str(one.file.parent), "fault": fault.sentence})
        quick = [verb for verb, options in OPTIONS.items() if "quick" in options]
        kinds = {} if self.studies.is_study else KINDS
        return {"studies": found, "single": self.studies.is_study, "quick": quick, "kinds": kinds}

    def _asked(self, request: Request) -> tuple[KnownStudy, str, str]:
        study, asked = self._study(request), request.query_params
        return study, asked.get("part", ""), asked.get("test", "")

    def _overview(self, request: Request) -> Any:
        study, part, test = self._asked(request)
        return overview(self.studies, study, part, test)

    def _search(self, request: Request) -> Any:
        study, part, test = self._asked(request)
        since = request.query_params.get("since", "0")
        results = self.studies.results(study, part, test)
        reader = self._ledgers.setdefault(study.key, LedgerReader(study.ledger))
        return search_view(reader, results, int(since) if since.isdigit() else 0)

    def _missing(self, request: Request) -> Any:
        study, part, test = self._asked(request)
        return {
            "explanation": missing(self.studies.results(study, part, test)),
            **overview(self.studies, study, part, test),
        }

    def _versions(self, request: Request) -> Any:
        study, part, _ = self._asked(request)
        return {"versions": versions(self.studies, study, part)}

    def _scene(self, request: Request) -> Any:
        return {"scene": space.scene(self._of_one(request))}

    def _of_one(self, request: Request) -> StudyResults:
        """Results of the test that is asked for, of several tests together those of the first."""
        results = self.studies.results(*self._asked(request))
        return results.tests[0] if results.tests else results

    def _correlation(self, request: Request) -> Any:
        results, study = self._of_one(request), self._study(request)
        own = StudyFile.read(study.file, results.test)
        stated = sorted(own.settings.pairing.override)
        found = {"undo": self.edits.last(own), "test": results.test, "stated": stated}
        return {"correlation": correlation_view(results), **found}

    def _measurement(self, request: Request) -> Any:
        results, study = self._of_one(request), self._study(request)
        own = StudyFile.read(study.file, results.test)
        return {"measurement": measurement(results, own), "undo": self.edits.last(own), "test": results.test}

    def _parameters(self, request: Request) -> Any:
        return {"parameters": parameters(self.studies.results(*self._asked(request)))}

    def _what_if(self, request: Request) -> Any:
        """The state of the process with the model of the test; of several tests together with that of the first."""
        study, part, test = self._asked(request)
        own = StudyFile.read(study.file, test)
        first = own.parts[0].test if own.settings.several and not test else test
        arguments = str(study.file), str(study.root), part if part in study.parts else "", first
        known = self.evaluators.of((study.key, part, test), arguments, stamp_of(study, own))
        return {**known.state, "test": test, "undo": self.edits.last(own)}

    def _evaluate(self, request: Request, given: Mapping[str, Any]) -> Any:
        asked, values = request.query_params, given.get("values")
        known = self.evaluators.ready((request.path_params["key"], asked.get("part", ""), asked.get("test", "")))
        if not isinstance(values, dict) or not all(isinstance(one, int | float) for one in values.values()):
            raise InputError("values are numbers by name", place="what if")
        return known.ask(given)

    # -- changes -------------------------------------------------------------------------------------------------------

    def _new(self, request: Request, given: Mapping[str, Any]) -> Any:
        return {"key": new_study(self.studies, given.get("name"), given.get("kind")).key}

    def _run(self, request: Request, given: Mapping[str, Any]) -> Any:
        study, options = self._study(request), given.get("options", {})
        if not isinstance(options, dict):
            raise InputError("options are named values", place="run")
        self.commands.start(study, str(given.get("verb", "")), options)
        return {"runs": self.commands.listing(study)}

    def _stop(self, request: Request, given: Mapping[str, Any]) -> Any:
        study, pid = self._study(request), given.get("pid")
        if not isinstance(pid, int) or not self.commands.stop(study, pid):
            raise LookupError("no such command runs on this study")
        return {"runs": self.commands.listing(study)}

    def _add(self, request: Request, given: Mapping[str, Any]) -> Any:
        study, part, test = self._asked(request)
        names, quick = given.get("effects"), bool(given.get("quick", False))
        table = self.studies.results(study, part, test).table("effects")
        known = set() if table is None else set(map(str, table["name"]))
        if not isinstance(names, list) or not names or not set(map(str, names)) <= known:
            raise InputError("these are no effects of the explanation", place="add", remedy="explain the study first")
        whole = self.studies.results(study, "quick" if quick else "")
        calibrated = "calibrate" in whole.analyses and not whole.stale.get("calibrate")
        written = uncalibrated(self.studies, study, list(map(str, names)), quick)
        commands = adding(study, list(map(str, names)), quick, calibrated, written)
        self.commands.start_all(study, commands, {"effects": names, "quick": quick})
        return {"runs": self.commands.listing(study)}

    def _edit(self, request: Request, given: Mapping[str, Any]) -> Any:
        study, _, test = self._asked(request)
        own, edit = StudyFile.read(study.file, test), given.get("edit")
        if not isinstance(edit, dict):
            raise InputError("no edit is named", place="edit")
        return (
            self.edits.make(own, edit, str(given.get("digest"))) if given.get("make") else self.edits.shown(own, edit)
        )

    def _undo(self, request: Request, given: Mapping[str, Any]) -> Any:
        study, _, test = self._asked(request)
        return self.edits.undo(StudyFile.read(study.file, test))

    # -- files ---------------------------------------------------------------------------------------------------------

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        content = self._files.get(name)
        if content is None:
            return _told({"fault": "there is no such file"}, 404)
        return Response(content, media_type=_KINDS[name.rpartition(".")[2]])

    async def _figure(self, request: Request) -> Response:
        def drawn() -> str:
            name = request.path_params["figure"]
            study, part, test = self._asked(request)
            with self._drawing, one_thread():
                results = self.studies.results(study, part, test)
                drawing = results.figures.plan.get(name)
                if drawing is None:
                    raise LookupError("the results have no such figure")
                place = study.key, part, test, name
                if self._drawn.get(place, ("", ""))[0] != drawing.key or not drawing.key:
                    self._drawn[place] = drawing.key, results.figures.svg(name)
                return self._drawn[place][1]

        return await _answered(drawn, "svg")

    async def _designs(self, request: Request) -> Response:
        def read() -> bytes:
            study, part, _ = self._asked(request)
            own = stamp_of(study, StudyFile.read(study.file)), request.query_params.get("evaluated", "")
            with self._reading:
                if self._designs_known[0] != (study.key, part, own):
                    text = designs_view(study.file, study.root, part if part in study.parts else "")
                    self._designs_known = (study.key, part, own), text
                return self._designs_known[1]

        return await _answered(read, "data")

    async def _report(self, request: Request) -> Response:
        def text() -> str:
            study, part, _ = self._asked(request)
            path = self.studies.report(study, part)
            if path is None:
                raise LookupError("there is no report yet: calib report STUDY writes it")
            return path.read_text("utf-8")

        found = await _answered(text, "html")
        found.headers["content-security-policy"] = _REPORT_POLICY
        return found


async def _answered(ask: Callable[[], Any], kind: str = "json") -> Response:
    """What a function returns; a sentence where the study, its results or the request are at fault."""
    try:
        found = await run_in_threadpool(ask)
    except InputError as fault:
        return _told({"fault": fault.sentence}, 409)
    except LookupError as fault:
        return _told({"fault": str(fault.args[0]) if fault.args else "not found"}, 404)
    except Exception as fault:  # the last resort: the page says what failed, and the server goes on
        return _told({"fault": f"unexpected {words_of(fault)}"}, 500)
    return _told(found) if kind == "json" else Response(found, media_type=_KINDS[kind])


def _told(content: Any, status: int = 200) -> Response:
    text = json.dumps(json_value(content), separators=(",", ":"), allow_nan=False, default=str)
    return Response(text, status, media_type="application/json")


def _files() -> dict[str, bytes]:
    """The files of the page by name: no other name is ever looked up."""
    page = resources.files("calib.workbench") / "page"
    own = {file.name: file.read_bytes() for file in page.iterdir() if file.name.rpartition(".")[2] in _KINDS}
    report = resources.files("calib.report.html") / "template"
    return own | {name: (report / name).read_bytes() for name in _OF_REPORT}
