"""The command ``mixer-train``: fit, validate and test what can be learned."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lightning import LightningDataModule, LightningModule, Trainer
from lightning.fabric.utilities.exceptions import MisconfigurationException
from lightning.pytorch.callbacks import EarlyStopping, ModelCheckpoint
from lightning.pytorch.cli import ArgsType, LightningArgumentParser, LightningCLI
from lightning.pytorch.loggers import CSVLogger

from mixer_torch.plugins import everything


class TrainCLI(LightningCLI):
    """LightningCLI with one folder for all that a run writes.

    ``--out DIR`` receives ``checkpoints/best.ckpt`` and ``last.ckpt``, ``logs/version_*`` (CSV and
    the resolved configuration), ``export/`` (what ``mixer associate`` reads) and ``test/``.
    ``fit --ckpt_path last`` goes on where an earlier run stopped, if there was one; ``validate``
    and ``test`` take ``checkpoints/best.ckpt`` unless told otherwise.
    """

    def add_arguments_to_parser(self, parser: LightningArgumentParser) -> None:
        parser.add_argument(
            "--out", type=Path, default=Path("out/train"), help="Folder to write to."
        )
        parser.add_lightning_class_args(ModelCheckpoint, "checkpoint")
        parser.add_lightning_class_args(EarlyStopping, "early_stopping")
        parser.set_defaults(
            {
                "checkpoint.monitor": "val/cllr",
                "checkpoint.filename": "best",
                "checkpoint.save_last": True,
                "checkpoint.enable_version_counter": False,
                "early_stopping.monitor": "val/cllr",
                "early_stopping.patience": 8,
                "early_stopping.min_delta": 1e-4,
            }
        )
        parser.link_arguments("out", "trainer.default_root_dir", compute_fn=str)
        parser.link_arguments(
            "out", "checkpoint.dirpath", compute_fn=lambda out: str(Path(out) / "checkpoints")
        )

    def instantiate_trainer(self, **kwargs: Any) -> Trainer:
        out = self._get(self.config_init, "out")
        if self._get(self.config_init, "trainer.logger") in (None, True):
            kwargs["logger"] = CSVLogger(out, name="logs")
        return super().instantiate_trainer(**kwargs)

    def before_instantiate_classes(self) -> None:
        """Let validate and test read what fit wrote; load nothing but weights and numbers."""
        config = self.config[self.subcommand]
        if config.weights_only is None:
            config.weights_only = True
        if config.ckpt_path is not None:  # going on in a folder, which is then not empty
            warnings.filterwarnings("ignore", message="Checkpoint directory .* is not empty")
        if self.subcommand in ("validate", "test") and config.ckpt_path is None:
            best = Path(config.out) / "checkpoints" / "best.ckpt"
            if not best.is_file():
                raise FileNotFoundError(f"{best}: not found; run mixer-train fit first")
            config.ckpt_path = str(best)

    def after_fit(self) -> None:
        """Export the best weights in the form that scorers and fusions load."""
        import torch

        export = getattr(self.model, "export", None)
        if not self.trainer.is_global_zero or export is None:
            return
        best = getattr(self.trainer.checkpoint_callback, "best_model_path", "")
        if best:
            state = torch.load(best, map_location="cpu", weights_only=True)["state_dict"]
            self.model.load_state_dict(state)
        folder = Path(self._get(self.config, "out")) / "export"
        written = export(folder, self._scorers())
        print("written: " + ", ".join(str(path) for path in written))  # noqa: T201

    def after_test(self) -> None:
        """Say what was found, and where it is."""
        if self.trainer.is_global_zero:
            print(getattr(self.model, "report", ""))  # noqa: T201
            print(f"written to {Path(self._get(self.config, 'out')) / 'test'}")  # noqa: T201

    def _scorers(self) -> list[Mapping[str, Any]]:
        data = self._get(self.config, "data")
        arguments = data.init_args if "init_args" in data else data
        listed = arguments.get("scorers") or []
        return [scorer.clone().as_dict() for scorer in listed]


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``mixer-train``.

    Args:
        argv: The arguments; those of the process if None.

    Returns:
        The exit code: 0, or 2 where the input is at fault, with one message on standard error.
        Set MIXER_TRACEBACK=1 to see where it came from.
    """
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    everything()  # makes bare class names known to the parser
    arguments: ArgsType = None if argv is None else list(argv)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*does not have many workers.*")
        warnings.filterwarnings("ignore", message=".*isinstance.treespec, LeafSpec.*")
        warnings.filterwarnings("ignore", message=".*args parameter is intended to run from.*")
        # Lightning's own calls of jsonargparse, not ours.
        warnings.filterwarnings(
            "ignore", category=DeprecationWarning, module=r"lightning\.pytorch\.cli"
        )
        logging.getLogger("lightning.pytorch.utilities.rank_zero").setLevel(logging.WARNING)
        try:
            TrainCLI(
                LightningModule,
                LightningDataModule,
                subclass_mode_model=True,
                subclass_mode_data=True,
                seed_everything_default=0,
                args=arguments,
                trainer_defaults={
                    "accelerator": "auto",
                    "max_epochs": 40,
                    "num_sanity_val_steps": 0,
                    "log_every_n_steps": 1,
                    "enable_model_summary": False,
                },
                parser_kwargs={"prog": "mixer-train"},
            )
        except (
            ValueError,
            KeyError,
            TypeError,
            OSError,
            ImportError,
            MisconfigurationException,
        ) as error:
            if os.environ.get("MIXER_TRACEBACK"):
                raise
            text = error.args[0] if isinstance(error, KeyError) and error.args else error
            print(f"mixer-train: error: {text}", file=sys.stderr)  # noqa: T201
            return 2
    return 0
