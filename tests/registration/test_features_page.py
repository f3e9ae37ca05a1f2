"""The examples of docs/features.md run as they stand, one after another."""

import re
from pathlib import Path

import torch

import torchreg as tr

PAGE = Path(__file__).parents[2] / "docs" / "features.md"


def test_the_pages_code_runs(capsys):
    names, results = {}, []
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    for block in blocks:
        names.pop("result", None)
        exec(block, names)
        results.append(names.get("result"))
    every, keypoints, matches, module, adapter = results
    T = names["pair"].T_target_source
    for result in (every, keypoints, module):
        assert result.success.tolist() == [True], result.reason
        assert float(tr.metrics.rre(T.view(4, 4), result.T_target_source[0])) < 2
    assert not bool(matches.success[0])
    assert adapter is None
    assert torch.equal(names["Describe"]()(names["source"]), names["f"])
    assert "features, compatibility" in capsys.readouterr().out
