"""Embeddings: from features, from our network, and from networks of others."""

import sys

import numpy as np
import pytest
import torch

import mixer_torch as mx
from mixer_torch.observations import Images, Observations
from mixer_torch.scorers.embedding import (
    BATCH,
    FEW,
    Embedding,
    EmbeddingNetwork,
    centred,
    crops_of,
    embed,
    save_embedding,
)


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


def test_mirrored_crops_have_the_same_vector(seen, tmp_path):
    network = EmbeddingNetwork(dimension=16, width=4, strips=2).eval()
    save_embedding(tmp_path / "net.safetensors", network)
    flipped = [np.ascontiguousarray(frame[:, ::-1]) for frame in seen.images.frames]
    mirrored = Observations(seen.view, {}, Images(flipped, np.arange(4)))
    for mirror in (False, True):
        scorer = Embedding(tmp_path / "net.safetensors", height=60, width=40, mirror=mirror)
        alike = torch.allclose(*(scorer.describe(each) for each in (seen, mirrored)), atol=1e-5)
        assert alike == mirror


def test_centred_vectors_have_lost_what_their_camera_adds():
    generator = torch.Generator().manual_seed(0)
    own = torch.randn(200, 6, generator=generator)
    camera = torch.arange(400) // 200 + 3
    light = torch.tensor([[4.0, 0, 0, 0, 0, 0], [0, -3.0, 0, 0, 0, 0]])[camera - 3]
    vectors = torch.cat([own, own]) + light
    seen = Observations(torch.full((400,), -1), {"embedding": vectors, "camera": camera})
    plain, centre = (Embedding(centre=value).describe(seen) for value in (False, True))
    same = [float((found[:200] * found[200:]).sum(1).mean()) for found in (plain, centre)]
    assert same[0] < 0.3
    assert same[1] > 0.6
    assert Embedding(centre=True).needs == ("embedding", "camera")
    torch.testing.assert_close(centre.norm(dim=1), torch.ones(400))


def test_few_and_missing_vectors_are_centred_by_hand():
    vectors = torch.tensor([[1.0, 0.0], [0.6, 0.8], [torch.nan, 1.0], [0.0, 1.0]])
    found = centred(vectors, torch.tensor([0, 0, 0, 1]))
    mean = torch.tensor([1.6, 0.8]) / (2 + FEW)
    expected = torch.nn.functional.normalize(vectors[:2] - mean, dim=1)
    torch.testing.assert_close(found[:2], expected)
    assert bool(found[2].isnan().any())
    torch.testing.assert_close(found[3], vectors[3])
    assert centred(vectors[:0], torch.zeros(0, dtype=torch.int64)).shape == (0, 2)


class Mean(torch.nn.Module):
    def forward(self, crops):
        return crops.mean((2, 3))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning")
def test_network_of_ones_own_as_torchscript(seen, tmp_path):
    torch.jit.trace(Mean(), torch.zeros(1, 3, 8, 8)).save(tmp_path / "mean.pt")
    vectors = Embedding(tmp_path / "mean.pt", height=8, width=8).describe(seen)
    expected = crops_of(seen.images, (8, 8)).mean((2, 3))
    torch.testing.assert_close(vectors, torch.nn.functional.normalize(expected, dim=1))


def message(number, content):
    """A field of the protocol-buffer wire format: a string, bytes, or an integer."""
    if isinstance(content, int):
        return bytes([number << 3, content])
    content = content.encode() if isinstance(content, str) else content
    size, length = b"", len(content)
    while length > 127:
        size, length = size + bytes([length & 127 | 128]), length >> 7
    return bytes([number << 3 | 2]) + size + bytes([length]) + content


def onnx_mean(operator="GlobalAveragePool"):
    """An ONNX file of the mean over a crop, of any number of crops, written by hand."""

    def value(name, *sizes):
        dims = b"".join(
            message(1, message(1, d) if isinstance(d, int) else message(2, d)) for d in sizes
        )
        tensor = message(1, message(1, 1) + message(2, dims))  # 1: float32
        return message(1, name) + message(2, tensor)

    pool = message(1, "x") + message(2, "p") + message(4, operator)
    flatten = message(1, "p") + message(2, "y") + message(4, "Flatten")
    graph = message(1, pool) + message(1, flatten) + message(2, "mean")
    graph += message(11, value("x", "B", 3, 8, 8)) + message(12, value("y", "B", 3))
    return message(1, 8) + message(7, graph) + message(8, message(1, "") + message(2, 13))


def test_network_of_ones_own_as_onnx(seen, tmp_path):
    (tmp_path / "mean.onnx").write_bytes(onnx_mean())
    scorer = Embedding(tmp_path / "mean.onnx", height=8, width=8)
    crops = crops_of(seen.images, (8, 8))
    expected = torch.nn.functional.normalize(crops.mean((2, 3)), dim=1)
    torch.testing.assert_close(scorer.describe(seen), expected)
    # Batches of other sizes, and more than one of them.
    many = torch.rand(BATCH + 3, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    expected = torch.nn.functional.normalize(many.mean((2, 3)), dim=1)
    torch.testing.assert_close(embed(scorer.network, many), expected)


def refuse(path):
    import cv2

    raise cv2.error("refused")


def test_onnxruntime_reads_what_opencv_does_not(seen, tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    (tmp_path / "mean.onnx").write_bytes(onnx_mean())
    expected = Embedding(tmp_path / "mean.onnx", height=8, width=8).describe(seen)
    monkeypatch.setattr("cv2.dnn.readNetFromONNX", refuse)
    scorer = Embedding(tmp_path / "mean.onnx", height=8, width=8)
    torch.testing.assert_close(scorer.describe(seen), expected)
    (tmp_path / "odd.onnx").write_bytes(onnx_mean("NoSuchOperator"))
    with pytest.raises(ValueError, match=r"odd\.onnx is not a readable ONNX file"):
        Embedding(tmp_path / "odd.onnx")


def test_without_onnxruntime_the_message_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "odd.onnx").write_bytes(onnx_mean("NoSuchOperator"))
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r"odd\.onnx .*pip install onnxruntime"):
        Embedding(tmp_path / "odd.onnx")


def test_files_that_are_something_else(tmp_path):
    with pytest.raises(FileNotFoundError, match="none"):
        Embedding(tmp_path / "none.pt")
    for name, match in (("a.txt", "expected .safetensors"), ("b.onnx", "b.onnx")):
        (tmp_path / name).write_text("no")
        with pytest.raises(ValueError, match=match):
            Embedding(tmp_path / name)
    with pytest.raises(ValueError, match="height, width"):
        Embedding(height=0)
