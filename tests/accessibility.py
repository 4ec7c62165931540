"""Pages audited by axe-core, which a Python package brings: nothing comes from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from axe_playwright_python.base import AXE_SCRIPT
from playwright.sync_api import Frame, Page

_GRAVE = ("serious", "critical")
_SCHEMES: Sequence[Literal["light", "dark"]] = ("light", "dark")
# Every frame is asked by itself: a frame does not answer for those inside it.
_AUDIT = """() => axe.run(document, {resultTypes: ["violations"], iframes: false})"""


def barriers(page: Page) -> list[str]:
    """Return what keeps people out of a page, in light and in dark, frames and all."""
    found: list[str] = []
    for scheme in _SCHEMES:
        page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
        for frame in filter(_is_shown, page.frames):
            found += [f"{scheme}: {text}" for text in _in_frame(frame)]
    return found


def _is_shown(frame: Frame) -> bool:
    return frame.parent_frame is None or frame.frame_element().is_visible()


def _in_frame(frame: Frame) -> list[str]:
    if not frame.evaluate("typeof axe !== 'undefined'"):
        frame.evaluate(AXE_SCRIPT)
    result: dict[str, Any] = frame.evaluate(_AUDIT)
    assert result["passes"], "nothing was audited"
    return [
        f"{rule['id']}: {rule['help']}: {node['target']} {node['failureSummary']}"
        for rule in result["violations"]
        if rule["impact"] in _GRAVE
        for node in rule["nodes"]
    ]
