"""A room whose cases hang, die and end: what the runner must live through."""

import os
import signal
import time
from collections.abc import Mapping
from typing import Any

from phytac_design.study.stability.case import Case, Evidence, Room


def check(values: Mapping[str, Any], found: Evidence) -> None:
    if values["do"] == "hang":
        time.sleep(600.0)
    if values["do"] == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if values["do"] == "grow":
        found.facts["bytes"] = float(len(bytearray(200 << 30)))
    found.add("reference", float(values["do"]), 1.0)


def case(name: str, do: Any, limit_s: float = 30.0) -> Case:
    return Case(room="crew", name=name, check="check", values={"do": do}, limit_s=limit_s)


ROOM = Room(name="crew", about="", checks={"check": check}, cases=list)
