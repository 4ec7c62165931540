"""Mistakes of authors: the message names file, line, column and the thing to change."""

import pytest
from broken_models import BROKEN

from fmus.frontend import load
from fmus.sources import ModelicaSource
from foundation.errors import ModelicaError


def test_there_are_enough_of_them():
    assert len(BROKEN) >= 20


@pytest.mark.parametrize("mistake", BROKEN)
def test_a_mistake_is_named_where_it_is(mistake):
    text, place, message = BROKEN[mistake]
    name = "P.T" if text.startswith("package P") else "T"
    with pytest.raises(ModelicaError, match=message) as caught:
        load(ModelicaSource(text, name, "bad.mo", "bad.mo"))
    assert str(caught.value).startswith(f"bad.mo:{place}: ")
