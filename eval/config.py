"""What a table is built from: real motion, what is evaluated, by which evaluators, under which protocol."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.clip_fid.score import Protocol
from eval.report.results import provenance
from eval.sample_folder import SampleFolder, SampleOptions, read_sample_folder
from eval.sets.motions import of_split_and
from eval.sets.sets import Missing
from eval.text_motion.guo.kind import GuoFiles
from motionkit.core.progress import OnProgress, ignore, task

if TYPE_CHECKING:
    from motionkit.store.reader import Store


@dataclass(frozen=True)
class EvalConfig:
    """Inputs of a table, the folder of its results, and a collector of what it lacks.

    Real motion: the sequences of `split` of the store ("all": any) for which `where` (SQL) holds. Evaluated: the models
    and encoders of `run`, folders of samples by the systems' names, `encoders` (pairs of an encoder's name and a run);
    a model generates at most `max_motions` motions, `draws` times. `evaluators` are feature sets or recognisers, None
    for all; `guo` and `motion_clip` are files of published ones. `clips` is clip-FID's protocol, before which every set
    is low-passed at `low_pass_hz`; `protocol` is of tables of whole motions. `fps` None means the table's
    own columns. `on_progress` is called during long steps.
    """

    store: Path
    results: Path
    split: str = "test"
    where: str | None = None
    run: Path | None = None
    samples: Mapping[str, Path] = field(default_factory=dict)
    sample_options: SampleOptions = field(default_factory=SampleOptions)
    encoders: tuple[tuple[str, Path], ...] = ()
    max_motions: int = 1024
    draws: int = 1
    evaluators: tuple[str, ...] | None = None
    guo: GuoFiles | None = None
    motion_clip: Path | None = None
    clips: Protocol = field(default_factory=Protocol)
    low_pass_hz: float | None = None
    protocol: str = "native"
    fps: tuple[Fraction, ...] | None = None
    seed: int = 0
    on_progress: OnProgress = field(default=ignore, compare=False, repr=False)
    missing: Missing = field(default_factory=Missing, compare=False, repr=False)

    @property
    def condition(self) -> str | None:
        """The SQL condition of the real motion; None for the whole store."""
        return of_split_and(self.split, self.where)

    @property
    def real(self) -> str:
        """The real motion's name in captions: the split, and the condition if there is one."""
        return f"split {self.split!r}" + (f" where {self.where}" if self.where else "")

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that every table's numbers depend on."""
        return {
            "split": self.split,
            "where": self.where,
            "low_pass_hz": self.low_pass_hz,
            "motions": self.max_motions,
            "draws": self.draws,
        }

    def open_store(self) -> "Store":
        """The store, for reading."""
        from motionkit.store.reader import Store

        return Store.open(self.store, on_progress=self.on_progress)

    def provenance(self, store: "Store", *others: Path, **more: Any) -> dict[str, Any]:
        """Provenance of a result: the store, the weights of evaluated and other runs, seed, environment, and `more`."""
        runs = (*([] if self.run is None else [self.run]), *others, *(run for _, run in self.encoders))
        name = self.run.name if self.run is not None and self.run.is_dir() else None
        known = provenance(store.path, [run for run in runs if run.is_dir()])
        return {**known, "run": name, **more, "seed": self.seed}

    @cached_property
    def sample_folders(self) -> tuple[SampleFolder, ...]:
        """The motions of every folder of samples, read when first accessed; raises `SampleFolderError`."""
        folders = []
        # Only published evaluators read pose vectors and KIT-ML's joints.
        keep = self.guo is not None or self.motion_clip is not None
        options = replace(self.sample_options, keep_published=keep)
        for name, path in self.samples.items():
            with task(self.on_progress, f"reading {name}") as work:
                folders.append(read_sample_folder(name, path, options, work.set))
        return tuple(folders)
