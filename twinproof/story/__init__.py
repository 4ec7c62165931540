"""The story of a twin on bundled things: friction appears, and what the service makes of it.

An arm is in the loop on its bus, verified; friction appears in its joint; the service flags drift,
closes the gate, names the effect, verifies the controller on the improved model, and opens the gate
or refuses with evidence. `twinproof demo --live` tells it in real time; the tests and the benchmark
of kills use the same files.
"""

from twinproof.story.files import StoryFiles
from twinproof.story.live import Told, tell_live
from twinproof.story.telling import Telling

__all__ = ["StoryFiles", "Telling", "Told", "tell_live"]
