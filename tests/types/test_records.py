"""Every type of tensors moves, loads, shows itself and is a pytree alike."""

import copy
import io
import pickle
import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest
import torch
from determinism import same_bits
from made import BATCHES, all_kinds, batch_of, cloud, records, result
from refusals import refuses
from torch import Tensor
from torch.utils import _pytree as pytree

import torchreg as tr
from torchreg.datasets import ScanPairBatch

RECORDS = records()

every_kind = pytest.mark.parametrize("kind", RECORDS, ids=lambda kind: kind.__name__)
every_batch = pytest.mark.parametrize("kind", BATCHES, ids=lambda kind: kind.__name__)


def tensors_of(value):
    """All tensors of a record, with the name of the field that holds them."""
    return dict(pytree.tree_flatten_with_path(value)[0])


def is_offsets(key):
    return str(key[-1]).endswith("offsets")


def loaded(value, **options):
    file = io.BytesIO()
    torch.save(value, file)
    file.seek(0)
    return torch.load(file, **options)


def test_no_type_is_forgotten_here():
    assert set(RECORDS) == {kind for kind in all_kinds() if kind.__module__.startswith("torchreg.")}


@every_kind
def test_a_file_is_loaded_with_weights_only(kind):
    assert same_bits(loaded(RECORDS[kind], weights_only=True), RECORDS[kind])


@every_kind
def test_copies_have_the_same_bits(kind):
    for made in (copy.deepcopy(RECORDS[kind]), pickle.loads(pickle.dumps(RECORDS[kind]))):
        assert same_bits(made, RECORDS[kind])


def test_what_a_file_holds_is_checked():
    one = cloud()
    object.__setattr__(one, "colors", one.colors[:1])
    with refuses("colors", "(2, 3)", "(1, 3)"):
        loaded(one, weights_only=True)


def test_a_result_of_a_descriptor_and_a_solver_of_ones_own_is_loaded_too():
    options = replace(tr.PAPER, descriptors=(OwnDescriptor(radius=1.0),), weights=(1.0,), solver=OwnSolver())
    made = replace(result(), options=(options,))
    assert loaded(made, weights_only=True).options == (options,)


class OwnDescriptor(tr.Fpfh):
    name = "own"


class OwnSolver(tr.Solver):
    name = "own"


@every_kind
def test_leaves_are_the_tensors_and_make_the_record_again(kind):
    leaves, structure = pytree.tree_flatten(RECORDS[kind])
    assert all(isinstance(leaf, Tensor) for leaf in leaves)
    assert same_bits(pytree.tree_unflatten(leaves, structure), RECORDS[kind])
    keys = [key for key, _ in pytree.tree_flatten_with_path(RECORDS[kind])[0]]
    assert len(set(map(pytree.keystr, keys))) == len(leaves)


@every_kind
def test_maps_over_trees_reach_every_tensor(kind):
    cloned = pytree.tree_map(torch.clone, RECORDS[kind])
    assert same_bits(cloned, RECORDS[kind])
    before, after = pytree.tree_leaves(RECORDS[kind]), pytree.tree_leaves(cloned)
    assert all(one is not other for one, other in zip(before, after, strict=True))


@every_kind
def test_leaves_may_be_anything(kind):
    emptied = pytree.tree_map(lambda _: None, RECORDS[kind])
    assert type(emptied) is kind
    assert repr(emptied)


@every_kind
def test_to_moves_all_but_the_offsets(kind):
    moved = RECORDS[kind].to("meta")
    assert {leaf.device.type for key, leaf in tensors_of(moved).items() if not is_offsets(key)} == {"meta"}
    assert {leaf.device.type for key, leaf in tensors_of(moved).items() if is_offsets(key)} <= {"cpu"}


@every_kind
def test_to_changes_the_dtype_of_what_has_that_of_the_points(kind):
    narrow = RECORDS[kind].to(torch.float32)
    assert same_bits(narrow, RECORDS[kind])
    wide = tensors_of(narrow.to(torch.float64))
    for key, leaf in tensors_of(narrow).items():
        assert wide[key].dtype == (torch.float64 if leaf.dtype == torch.float32 else leaf.dtype), key
    assert same_bits(RECORDS[kind].to(torch.float64).to(torch.float32), RECORDS[kind])


@every_kind
def test_to_takes_what_the_to_of_tensors_takes(kind):
    record, like = RECORDS[kind], torch.zeros(1, dtype=torch.float64)
    wide = record.to(torch.float64)
    ways = (
        record.to(dtype=torch.float64),
        record.to("cpu", torch.float64),
        record.to(like),
        record.to(None, like.dtype),
    )
    assert all(same_bits(same, wide) for same in ways)
    assert same_bits(record.cpu(), record)
    with refuses("dtype", "floating point", "torch.int64"):
        record.to(torch.int64)


@pytest.fixture
def copies(monkeypatch):
    """What ``Tensor.to`` is called with; nothing is copied."""
    calls = []

    def to(self, **words):
        calls.append(words)
        return self

    monkeypatch.setattr(Tensor, "to", to)
    return calls


@every_kind
@pytest.mark.parametrize("waits", [True, False])
def test_to_a_gpu_need_not_be_waited_for(kind, waits, copies):
    record = RECORDS[kind]
    runs = (
        lambda: record.to("cuda", non_blocking=not waits),
        lambda: record.cuda(non_blocking=not waits),
        lambda: record.cuda(1, non_blocking=not waits),
    )
    moving = sum(not is_offsets(key) for key in tensors_of(record))
    for run, device in zip(runs, ("cuda", "cuda", "cuda:1"), strict=True):
        copies.clear()
        run()
        assert len(copies) == moving
        assert all(torch.device(words["device"]) == torch.device(device) for words in copies)
        assert all(words["non_blocking"] is not waits for words in copies)


@every_kind
def test_a_loader_pins_every_tensor_but_offsets(kind, monkeypatch):
    from torch.utils.data._utils.pin_memory import pin_memory

    pinned = []
    monkeypatch.setattr(Tensor, "pin_memory", lambda self, *_: pinned.append(self) or self)
    assert same_bits(pin_memory({"record": RECORDS[kind]})["record"], RECORDS[kind])
    assert len(pinned) == sum(not is_offsets(key) for key in tensors_of(RECORDS[kind]))


def test_gradients_flow_through_to_and_end_at_detach():
    points = torch.rand(4, 3, requires_grad=True)
    moved = tr.Clouds(points).to(torch.float64)
    assert moved.points.requires_grad
    assert not moved.detach().points.requires_grad


@every_kind
def test_a_repr_has_three_lines_at_most(kind):
    for one in (RECORDS[kind], *([RECORDS[kind][0]] if hasattr(kind, "__getitem__") else [])):
        lines = repr(one).split("\n")
        assert lines[0].startswith(f"{kind.__name__}(")
        assert len(lines) <= 3
        assert all(len(line) < 200 for line in lines) or kind.__name__ == "Link"


@every_kind
def test_html_shows_a_row_per_item(kind):
    html = RECORDS[kind]._repr_html_()
    assert html.startswith("<div><strong>" + kind.__name__)
    assert html.count("<tr>") == (len(RECORDS[kind]) + 1 if kind in BATCHES else 0)


def test_html_escapes_texts_and_ends_somewhere():
    long = ScanPairBatch.pack([BATCHES[ScanPairBatch](seed) for seed in range(30)])
    html = long._repr_html_()
    assert "&lt;pair 0&gt;" in html
    assert "<pair" not in html
    assert html.count("<tr>") == 21
    assert "and 10 more pairs" in html


@pytest.mark.parametrize(
    ("record", "parts"),
    [
        (cloud(1), ["1 cloud of 3 points", "colors, normals, viewpoints known: yes", "float32 on cpu"]),
        (batch_of(tr.Clouds), ["3 clouds of 2 + 3 + 4 points"]),
        (tr.Clouds(torch.zeros(1500, 3)), ["1,500 points", "no colors, no normals, no viewpoint"]),
        (batch_of(tr.Features), ["3 + 4 + 5 points of 3 clouds, 3 invalid", "fpfh 3 + pcfh 2"]),
        (batch_of(tr.Correspondences), ["1 + 2 + 3 matches of 3 pairs"]),
        (batch_of(tr.SoftCorrespondences), ["2 x 4, 3 x 4, 4 x 4"]),
        (
            batch_of(tr.RegistrationResult),
            ["3 pairs, 2 registered", "0.998, 0.07, 0.998", "refused: pair 1: ambiguous"],
        ),
        (batch_of(tr.Verification), ["3 transforms, 3 held to be right", "none refused"]),
        (batch_of(tr.IcpResult), ["3 pairs, 2 converged", "pair 1: motion open"]),
        (batch_of(ScanPairBatch), ["3 pairs: <pair 0>, <pair 1>, <pair 2>", "true motion of 3 known"]),
        (cloud(1).to("meta"), ["Clouds(points (3, 3) on meta"]),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_repr_says_what_there_is(record, parts):
    assert all(part in repr(record) for part in parts), repr(record)


def test_the_fields_of_a_type_are_declared_where_they_hold_tensors():
    """A tensor in a field that is not declared is taken for one that all items share."""
    for kind in BATCHES:
        for each in fields(kind):
            value = getattr(RECORDS[kind], each.name)
            if isinstance(value, Tensor) or is_dataclass(value):
                assert "held" in each.metadata, (kind, each.name)


def test_a_type_of_ones_own_has_all_manners_by_what_its_fields_say():
    page = (Path(__file__).parents[2] / "docs" / "types.md").read_text()
    (code,) = [
        block for block in re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE) if "Labels" in block
    ]
    names = {"torch": torch, "__name__": "made_here"}
    exec(code, names)
    one = names["Labels"](torch.arange(5), torch.tensor([0, 2, 5]), torch.tensor([0.5, 1.0]), ("a", "b"))
    assert one[1].classes.tolist() == [2, 3, 4]
    assert one[[1, 0]].names == ("b", "a")
    assert same_bits(names["Labels"].pack(list(one)), one)
    assert one.to(torch.float64).weight.dtype == torch.float64
    assert same_bits(pytree.tree_map(torch.clone, one), one)
    assert "<td>b</td>" in one._repr_html_()
