"""Naming the shape that a map shows."""

import numpy as np
import pytest
import torch

from tactorch.errors import FileError, MeshError
from tactorch.learning.recognizer import Recognizer, load_recognizer, recognise
from tactorch.mesh import box_mesh

MESH = box_mesh(10.0, 4)
CLASSES = ["cake", "cone", "torus"]


@pytest.fixture
def network():
    torch.manual_seed(0)
    return Recognizer(CLASSES, mean=-1.0, deviation=0.5, hidden=4)


def save(network, path):
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "state_dict": network.state_dict(),
        "hyper_parameters": dict(network.hparams),
    }
    torch.save(content, path)
    return path


def test_the_answers_are_those_of_the_network_likeliest_first(network, tmp_path):
    youngs = np.where(MESH.centroids[:, 2] > 5, 1.0, 0.2)
    found = recognise(MESH, youngs, network)
    assert set(found) == set(CLASSES)
    assert sum(found.values()) == pytest.approx(1.0, abs=1e-6)
    assert list(found.values()) == sorted(found.values(), reverse=True)
    save(network, tmp_path / "run" / "split-03" / "best.ckpt")
    again = recognise(MESH, youngs, load_recognizer(tmp_path / "run"))
    assert again == pytest.approx(found)
    other = recognise(MESH, np.where(MESH.centroids[:, 0] > 5, 1.0, 0.2), network)
    assert other != pytest.approx(found, abs=1e-6)


def test_bad_checkpoints_and_maps_are_refused(network, tmp_path):
    with pytest.raises(FileError, match="not found"):
        load_recognizer(tmp_path)
    path = save(network, tmp_path / "best.ckpt")
    content = torch.load(path, weights_only=True)
    content["hyper_parameters"]["hidden"] = 5
    torch.save(content, path)
    with pytest.raises(FileError, match="not a recognizer's"):
        load_recognizer(tmp_path)
    with pytest.raises(MeshError):
        recognise(MESH, np.ones(3), network)
