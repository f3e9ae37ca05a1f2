"""Datasets over folders of fragments: which file is which, where the log may lie, and what is refused."""

import pytest
import torch
from folders import block, cloud, motion, scene_folder
from refusals import refuses
from torch.utils.data import DataLoader

import torchreg as tr
from torchreg.datasets import Fragments, pack_pairs


def test_the_matrix_takes_the_second_fragment_to_the_first(tmp_path):
    scene = tmp_path / "kitchen"
    scene.mkdir()
    T_0_1 = motion(4)
    moved = tr.transform(cloud(1), T_0_1)
    tr.write_cloud(scene / "cloud_bin_1.ply", cloud(1))
    tr.write_cloud(scene / "cloud_bin_0.ply", moved)
    (scene / "gt.log").write_text(block(0, 1, 2, T_0_1))
    (pair,) = Fragments(scene)
    assert pair.name == "kitchen__cloud_bin_1__cloud_bin_0"
    there = tr.transform(pair.source, pair.T_target_source)
    whole = pair.target.points + pair.target.origin
    assert torch.allclose(there.points.double() + there.origin, whole, atol=1e-5)
    assert float(tr.metrics.fitness(pair.source, pair.target, pair.T_target_source[None], 1e-4)) == 1


def test_items_are_what_the_files_hold(tmp_path):
    scene = scene_folder(tmp_path / "hall", information=True)
    dataset = Fragments(scene)
    assert len(dataset) == 2
    for j, pair in enumerate(dataset, start=1):
        assert torch.equal(pair.source.points, tr.read_cloud(scene / f"cloud_bin_{j}.ply").points)
        assert torch.equal(pair.target.points, tr.read_cloud(scene / "cloud_bin_0.ply").points)
        assert torch.equal(pair.T_target_source, motion(j))
        assert torch.equal(pair.information, torch.full((6, 6), float(j), dtype=torch.float64))
    assert [path.name for path in dataset.clouds().paths] == [f"cloud_bin_{k}.ply" for k in (1, 0, 2)]
    (batch,) = DataLoader(dataset, batch_size=2, collate_fn=pack_pairs)
    assert batch.information[:, 0, 0].tolist() == [1, 2]


@pytest.mark.parametrize("name", ["gt.log", "truth.log"])
@pytest.mark.parametrize("beside", [False, True])
def test_where_the_log_may_lie(tmp_path, name, beside):
    scene = tmp_path / "7-scenes-redkitchen"
    logs = tmp_path / "7-scenes-redkitchen-evaluation" if beside else scene
    scene_folder(scene, logs)
    (logs / "gt.log").rename(logs / name)
    for folder in (scene, tmp_path):  # the scene itself, and the folder of scenes that holds it
        assert Fragments(folder).names == tuple(f"{scene.name}__cloud_bin_{j}__cloud_bin_0" for j in (1, 2))


def test_scenes_come_in_the_order_of_their_names(tmp_path):
    scene_folder(tmp_path / "b", information=True)
    scene_folder(tmp_path / "a", tmp_path / "a-evaluation")
    (tmp_path / "notes").mkdir()
    (tmp_path / "a.txt").write_text("nothing")
    dataset = Fragments(tmp_path, voxel_size=0.5, colors=True)
    assert [name[0] for name in dataset.names] == ["a", "a", "b", "b"]
    assert len(dataset.clouds()) == 6
    batch = pack_pairs(list(dataset))
    assert batch.information[:, 0, 0].isnan().tolist() == [True, True, False, False]


def test_refused(tmp_path):
    with refuses("folder", "a folder that exists"):
        Fragments(tmp_path / "none")
    with refuses(str(tmp_path), "fragments cloud_bin_0.ply"):
        Fragments(tmp_path)
    scene = scene_folder(tmp_path / "s")
    log = scene / "gt.log"
    with refuses("voxel_size"):
        Fragments(scene, voxel_size=-1)
    whole = log.read_text()
    log.write_text(whole[: len(whole) * 3 // 4])
    with refuses(f"{log}, line 6", "4 lines of numbers below it, got 2"):
        Fragments(scene)
    log.write_text(whole + block(2, 7, 9, motion(1)))
    with refuses(f"{log}, line 11", "a fragment that is there", "cloud_bin_7.ply"):
        Fragments(scene)
    log.write_text(whole + whole)
    with refuses(f"{log}, line 11", "0 1 as in line 1"):
        Fragments(scene)
    log.write_text(whole)
    (scene / "gt.info").write_text(block(0, 1, 3, torch.eye(6)))
    with refuses(str(scene / "gt.info"), "every pair of gt.log", "none for 0 2"):
        Fragments(scene)


def test_missing_and_doubtful_logs_are_refused(tmp_path):
    scene = scene_folder(tmp_path / "s")
    (scene / "gt.log").rename(scene / "one.log")
    assert len(Fragments(scene)) == 2
    (scene / "two.log").write_bytes((scene / "one.log").read_bytes())
    with refuses(str(scene), "gt.log in it or in s-evaluation beside it", "one.log, two.log"):
        Fragments(scene)
    for name in ("one.log", "two.log"):
        (scene / name).unlink()
    for folder in (scene, tmp_path):  # a scene among others is not passed over
        with refuses(str(scene), "gt.log", "none"):
            Fragments(folder)
    for fragment in scene.glob("*.ply"):
        fragment.unlink()
    (scene / "gt.log").write_text(block(0, 1, 2, motion(0)))
    with refuses(f"{scene / 'gt.log'}, line 1", "cloud_bin_0.ply"):
        Fragments(scene)


def test_another_log_by_its_name(tmp_path):
    scene = scene_folder(tmp_path / "s", tmp_path / "s-evaluation", information=True)
    low = tmp_path / "s-evaluation" / "gt_lo.log"
    low.write_text(block(1, 2, 3, motion(7)))
    low.with_suffix(".info").write_text(block(1, 2, 3, 7 * torch.eye(6)))
    dataset = Fragments(tmp_path, log="gt_lo.log")
    assert (dataset.scenes, dataset.numbers) == (("s",), ((1, 2),))
    assert torch.equal(dataset[0].T_target_source, motion(7))
    assert float(dataset[0].information[0, 0]) == 7
    assert Fragments(scene).numbers == ((0, 1), (0, 2))
    with refuses(str(scene), "other.log"):
        Fragments(tmp_path, log="other.log")
    with refuses("log", "a folder that exists", "away/gt.log"):
        Fragments(tmp_path, log="away/gt.log")


@pytest.mark.parametrize("suffix", ["", "-evaluation"])
def test_logs_in_a_folder_of_their_own(tmp_path, suffix):
    scene = scene_folder(tmp_path / "data" / "s", tmp_path / "away")
    logs = tmp_path / "benchmarks" / "3DLoMatch"
    (logs / f"s{suffix}").mkdir(parents=True)
    (logs / f"s{suffix}" / "gt.log").write_text(block(1, 2, 3, motion(7)))
    for folder in (scene, tmp_path / "data"):
        assert Fragments(folder, log=logs).numbers == ((1, 2),)


def test_scenes_of_the_eth(tmp_path):
    scene = scene_folder(tmp_path / "gazebo_summer")
    for k in range(3):
        (scene / f"cloud_bin_{k}.ply").rename(scene / f"Hokuyo_{k}.ply")
    dataset = Fragments(tmp_path)
    assert dataset.names == tuple(f"gazebo_summer__Hokuyo_{j}__Hokuyo_0" for j in (1, 2))
    assert torch.equal(dataset[1].source.points, tr.read_cloud(scene / "Hokuyo_2.ply").points)
    (scene / "Hokuyo_2.ply").unlink()
    with refuses(f"{scene / 'gt.log'}, line 6", "Hokuyo_2.ply"):
        Fragments(scene)
