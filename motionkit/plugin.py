"""motionkit's own commands, stages and text encoders (`motionkit.core.plugins`)."""

COMMANDS = {
    "compact": "motionkit.cli.store:compact",
    "complete": "motionkit.cli.edit:complete",
    "convert": "motionkit.cli.edit:convert",
    "export": "motionkit.cli.export:export",
    "generate": "motionkit.cli.generate:generate",
    "info": "motionkit.cli.info:info",
    "ingest": "motionkit.cli.ingest:ingest",
    "merge": "motionkit.cli.store:merge",
    "pack": "motionkit.cli.hub:pack",
    "plant": "motionkit.cli.edit:plant",
    "pull": "motionkit.cli.hub:pull",
    "push": "motionkit.cli.hub:push",
    "query": "motionkit.cli.query:query",
    "remove": "motionkit.cli.store:remove",
    "serve": "motionkit.cli.serve:serve",
    "split": "motionkit.cli.store:split",
    "train": "motionkit.cli.train:train",
    "validate": "motionkit.cli.store:validate",
    "view": "motionkit.cli.view:view",
}
STAGES = {"detail": "motionkit.training.detail:STAGE"}
TEXT_ENCODERS = {
    "minilm": "motionkit.training.text:load_minilm",
    "clip": "motionkit.training.text:load_transformers",
    "transformers": "motionkit.training.text:load_transformers",
}
