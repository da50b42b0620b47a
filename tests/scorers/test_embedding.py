"""Embeddings: from features, from our network, and from networks of others."""

import numpy as np
import pytest
import torch

import mixer_torch as mx
from mixer_torch.observations import Images, Observations
from scorers.embedding import Embedding, EmbeddingNetwork, crops_of, save_embedding


@pytest.fixture
def seen():
    generator = np.random.default_rng(0)
    frames = [generator.integers(0, 255, (60, 40, 3), dtype=np.uint8) for _ in range(4)]
    return Observations(torch.arange(4), {}, Images(frames, np.arange(4)))


def test_cosine_of_given_vectors():
    vectors = torch.tensor([[2.0, 0.0], [5.0, 0.0], [0.0, 1.0], [torch.nan, 1.0]])
    seen = Observations(torch.arange(4), {"embedding": vectors})
    evidence = Embedding().evidence(seen, mx.Every()(seen))
    torch.testing.assert_close(evidence[[0, 1, 3]], torch.tensor([1.0, 0.0, 0.0]))
    assert bool(evidence[[2, 4, 5]].isnan().all())


def test_network_from_its_file(seen, tmp_path):
    network = EmbeddingNetwork(dimension=16, width=4, strips=2).eval()
    save_embedding(tmp_path / "net.safetensors", network)
    scorer = Embedding(tmp_path / "net.safetensors", height=64, width=32)
    vectors = scorer.describe(seen)
    expected = network(crops_of(seen.images, (64, 32)))
    torch.testing.assert_close(vectors, expected.detach(), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(vectors.norm(dim=1), torch.ones(4))
    scores = scorer(seen, mx.Every()(seen))
    assert scores.shape == (6,)


def test_colour_cast_changes_nothing():
    network = EmbeddingNetwork(dimension=16, width=4, strips=2).eval()
    crops = torch.rand(2, 3, 64, 32, generator=torch.Generator().manual_seed(0))
    cast = crops * torch.tensor([0.5, 0.9, 0.7])[:, None, None] + 0.05
    torch.testing.assert_close(network(cast), network(crops), rtol=1e-3, atol=1e-3)


class Mean(torch.nn.Module):
    def forward(self, crops):
        return crops.mean((2, 3))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_network_of_ones_own_as_torchscript(seen, tmp_path):
    torch.jit.trace(Mean(), torch.zeros(1, 3, 8, 8)).save(tmp_path / "mean.pt")
    vectors = Embedding(tmp_path / "mean.pt", height=8, width=8).describe(seen)
    expected = crops_of(seen.images, (8, 8)).mean((2, 3))
    torch.testing.assert_close(vectors, torch.nn.functional.normalize(expected, dim=1))


def test_files_that_are_something_else(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        Embedding(tmp_path / "none.pt")
    for name, match in (("a.txt", "expected .safetensors"), ("b.onnx", "b.onnx")):
        (tmp_path / name).write_text("no")
        with pytest.raises(ValueError, match=match):
            Embedding(tmp_path / name)
    with pytest.raises(ValueError, match="height, width"):
        Embedding(height=0)
