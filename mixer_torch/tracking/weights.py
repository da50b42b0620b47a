"""What was learned on labelled sequences: small additive networks of log likelihood ratios."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

FORMAT = "mixer-torch tracking weights 1"
NETWORKS = ("objectness", "evidence", "rivals", "joins", "tracks")
FARTHEST = 4.0
"""Standard deviations beyond which an input is taken as this far."""


@dataclass(frozen=True)
class Network:
    """A sum of one small network for each modality, each of a hidden layer and a linear part.

        log LR(x) = bias + sum over modalities k of  w_k . z_k + v_k . relu(W_k z_k + b_k),

    with z the features standardised and bounded. A modality's hidden units see its own features
    and the context alone, so that what each says can be told apart (:meth:`parts`).

    Args:
        features: Names of the inputs.
        modality: The modality of each input; "context" for covariates, which all see.
        owner: (h,) the modality of each hidden unit.
        mean, scale: (f,) of the inputs.
        hidden: (f, h) W, 0 where a unit does not see an input.
        hidden_bias: (h,).
        out: (h,) v.
        linear: (f,) w.
        bias: The rest.
    """

    features: tuple[str, ...]
    modality: tuple[str, ...]
    owner: tuple[str, ...]
    mean: Float64[np.ndarray, " f"]
    scale: Float64[np.ndarray, " f"]
    hidden: Float64[np.ndarray, "f h"]
    hidden_bias: Float64[np.ndarray, " h"]
    out: Float64[np.ndarray, " h"]
    linear: Float64[np.ndarray, " f"]
    bias: float

    @classmethod
    def silent(
        cls, features: tuple[str, ...], modality: tuple[str, ...], owner: tuple[str, ...]
    ) -> Network:
        """One that says nothing: 0 of everything."""
        f, h = len(features), len(owner)
        zero = np.zeros(f)
        unit = np.zeros((f, h)), np.zeros(h), np.zeros(h)
        return cls(features, modality, owner, zero, np.ones(f), *unit, zero, 0.0)

    def __call__(self, x: Float64[np.ndarray, "P f"]) -> Float64[np.ndarray, " P"]:
        """(P,) log likelihood ratios, nats."""
        z = self._standardised(x)
        return (
            np.maximum(z @ self.hidden + self.hidden_bias, 0) @ self.out
            + z @ self.linear
            + self.bias
        )

    def parts(self, x: Float64[np.ndarray, "P f"]) -> dict[str, Float64[np.ndarray, " P"]]:
        """What each modality adds to the log likelihood ratio; "context" has the constant."""
        z = self._standardised(x)
        active = np.maximum(z @ self.hidden + self.hidden_bias, 0) * self.out
        parts = {}
        for name in dict.fromkeys(self.modality):
            own = np.array([m == name for m in self.modality])
            units = np.array([m == name for m in self.owner])
            parts[name] = z[:, own] @ self.linear[own] + active[:, units].sum(1)
        parts["context"] = parts.get("context", 0) + self.bias
        return parts

    def _standardised(self, x: np.ndarray) -> np.ndarray:
        return np.clip((x - self.mean) / self.scale, -FARTHEST, FARTHEST)


@dataclass(frozen=True)
class Weights:
    """All networks of a tracker.

    Args:
        networks: By name, of :data:`NETWORKS`.
        card: What they were learned on, and how well they did there.
    """

    networks: Mapping[str, Network]
    card: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Network:
        return self.networks[name]

    def check(self, inputs: Mapping[str, tuple[str, ...]]) -> None:
        """ValueError where a network is missing, or was learned on other inputs than these."""
        for name, features in inputs.items():
            if name not in self.networks:
                raise ValueError(f"weights: expected a network {name!r}, which is missing")
            if self.networks[name].features != features:
                raise ValueError(
                    f"weights: network {name!r} was learned on other inputs than this version of "
                    "mixer-torch has; learn it anew (mixer track --train)"
                )

    def save(self, path: str | Path) -> None:
        """Write a safetensors file; what is not a tensor is in its metadata."""
        from safetensors.numpy import save_file

        tensors: dict[str, np.ndarray] = {}
        names: dict[str, Any] = {}
        for name, network in self.networks.items():
            values = dict(vars(network))
            names[name] = {
                key: values.pop(key) for key in ("features", "modality", "owner", "bias")
            }
            tensors |= {
                f"{name}.{key}": np.ascontiguousarray(value, dtype=np.float32)
                for key, value in values.items()
            }
        metadata = {
            "format": FORMAT,
            "networks": json.dumps(names),
            "card": json.dumps(dict(self.card)),
        }
        save_file(tensors, str(path), metadata)

    @classmethod
    def load(cls, path: str | Path) -> Weights:
        """Read what :meth:`save` wrote.

        Raises:
            FileNotFoundError: There is no such file.
            ValueError: It is no file of tracking weights.
        """
        from safetensors import SafetensorError, safe_open

        if not Path(path).is_file():
            raise FileNotFoundError(f"weights: {path} does not exist")
        try:
            with safe_open(str(path), framework="numpy") as file:
                metadata = file.metadata() or {}
                names = file.keys()
                tensors = {key: file.get_tensor(key).astype(np.float64) for key in names}
        except SafetensorError as error:
            raise ValueError(f"weights: {path} is no safetensors file: {error}") from error
        if metadata.get("format") != FORMAT:
            raise ValueError(
                f"weights: {path} holds {metadata.get('format', 'something else')!r}, "
                f"expected {FORMAT!r}"
            )
        networks = {}
        for name, rest in json.loads(metadata["networks"]).items():
            own = {k.split(".", 1)[1]: v for k, v in tensors.items() if k.startswith(f"{name}.")}
            lists: dict[str, Any] = {
                key: tuple(rest[key]) for key in ("features", "modality", "owner")
            }
            networks[name] = Network(**lists, **own, bias=rest["bias"])
        return cls(networks, json.loads(metadata["card"]))

    @classmethod
    def shipped(cls) -> Weights:
        """Those that come with the project; ``docs/tracking.md`` says what they were learned on."""
        return cls.load(str(resources.files("mixer_torch.tracking") / "tracker.safetensors"))


def masks(
    modality: Sequence[str], units: int
) -> tuple[tuple[str, ...], Float64[np.ndarray, "f h"]]:
    """Which modality owns each hidden unit, and which inputs each unit sees.

    Args:
        modality: Of each input, "context" for covariates.
        units: Hidden units of each modality.
    """
    kinds = [name for name in dict.fromkeys(modality) if name != "context"]
    owner = tuple(name for name in kinds for _ in range(units))
    sees = [[m in (name, "context") for name in owner] for m in modality]
    return owner, np.array(sees, dtype=float)
