"""Rows of the paper's experiments as its benchmark measures them, with numbers of one's own."""

import torch

from torchreg.benchmark.paper.ways import OURS


def row(setting, group, place, method, way=OURS, rre=(1.0,), rte=(0.1,), rmse=(0.2,), threshold=0.2):
    """One setting at one place; errors are lists, a number for every run."""
    return {
        "key": f"{setting.experiment}/{setting.name}/{group.name}-{place}/{way.name}/{method}",
        "experiment": setting.experiment,
        "setting": setting.name,
        "group": group.name,
        "place": f"{group.name}-{place}",
        "way": way.name,
        "method": method,
        "rre_degrees": list(rre),
        "rte_meters": list(rte),
        "rmse_meters": list(rmse),
        "inlier_ratio": 0.25,
        "threshold": threshold,
        "T_target_source": torch.eye(4).tolist(),
    }
