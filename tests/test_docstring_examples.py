"""Every public name has an example in its docstring, and the examples give what they say."""

import doctest
import importlib
import inspect
from pathlib import Path

import pytest
import torch

import torchreg as tr

ROOT = Path(__file__).parents[1]


def public_names():
    """The names that the API reference describes, as ``docs/api_pages.py`` lists them."""
    spec = importlib.util.spec_from_file_location("api_pages", ROOT / "docs" / "api_pages.py")
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    return [public for public in pages.public_names() if public.has_docstring]


def marked(public):
    """Examples that register, train or simulate much take more than some seconds on a busy machine."""
    text = inspect.getdoc(public.value) or ""
    heavy = ("register(", "register_", "verify(", "building(", "simulated_pairs", "train", "figure(", "compare(")
    marks = [pytest.mark.slow] if any(word in text.partition(">>>")[2] for word in heavy) else []
    return pytest.param(public, id=public.path, marks=marks)


PUBLIC = public_names()


@pytest.mark.parametrize("public", PUBLIC, ids=lambda public: public.path)
def test_every_public_name_has_an_example(public):
    assert ">>>" in (inspect.getdoc(public.value) or ""), f"{public.path} has no example in its docstring"


@pytest.mark.parametrize("public", [marked(public) for public in PUBLIC])
def test_examples_give_what_they_say(public, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("a.ply", "b.ply"):
        tr.write_cloud(name, tr.Clouds(torch.rand(500, 3)))
    value = inspect.unwrap(public.value) if inspect.isroutine(public.value) else public.value
    runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    said = []
    names = {**vars(inspect.getmodule(value)), "torch": torch, "tr": tr}
    for test in doctest.DocTestFinder().find(value, public.path, globs=names):
        runner.run(test, out=said.append)
    assert runner.failures == 0, "".join(said)
