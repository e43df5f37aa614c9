"""NeRM's ablations as `motionkit ablate` trains them: a run a variant, one codebook for all."""

from motionkit.training.ablations import Ablations, Sweep, check_unchanged
from motionkit.training.run import RunFolder, copy_stage
from nerm.ablations.variants import ABLATIONS
from nerm.recipes import RECIPES, NermConfig
from nerm.stages import CODEBOOK, DENOISER, FIELD

CODEBOOK_SEED = 0


def share_codebook(sweep: Sweep, run: RunFolder, config: NermConfig) -> None:
    """Give a run the codebook of RUNS/PREFIX, which is trained first where there is none.

    The variants differ in how the codes are used, not in the codes, so they have the same ones. One that uses none gets
    none.
    """
    if config.field.time_encoding != "codebook":
        return
    common = RunFolder(sweep.runs / sweep.prefix)
    context = sweep.context(common, CODEBOOK_SEED, overwrite=False)
    source, target = common.stage(CODEBOOK.name), run.stage(CODEBOOK.name)
    if source.is_complete:
        check_unchanged(context, CODEBOOK, config)
    else:
        CODEBOOK.train(context, config)
    if target.is_complete and target.model_path.read_bytes() == source.model_path.read_bytes():
        return
    copy_stage(source, target)


NERM = Ablations("nerm", ABLATIONS, RECIPES, {"field": FIELD, "denoiser": DENOISER}, share_codebook, is_default=True)
