"""Modules that are put off are loaded when something of theirs is used, and then are what they are."""

import sys

import pytest

from compplan.io.lazy_imports import put_off


@pytest.fixture
def unloaded(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("wsgiref", "wsgiref.util"):
        monkeypatch.delitem(sys.modules, name, raising=False)


@pytest.mark.usefixtures("unloaded")
def test_a_module_put_off_is_loaded_by_its_first_use() -> None:
    put_off(("wsgiref", "wsgiref.util"))
    import wsgiref.util as asked

    assert "request_uri" not in vars(asked)
    assert asked.request_uri.__module__ == "wsgiref.util"
    assert asked is not sys.modules["wsgiref.util"] and hasattr(sys.modules["wsgiref.util"], "__file__")


@pytest.mark.usefixtures("unloaded")
def test_a_part_of_a_module_put_off_is_found() -> None:
    put_off(("wsgiref",))
    from wsgiref.util import request_uri

    assert request_uri.__module__ == "wsgiref.util"


def test_what_is_loaded_stays() -> None:
    before = sys.modules["sys"]
    put_off(("sys",))
    assert sys.modules["sys"] is before
