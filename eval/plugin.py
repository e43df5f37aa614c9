"""The commands, stages and tables of the evaluation (`motionkit.core.plugins`)."""

COMMANDS = {
    "ablate": "eval.commands.ablate:ablate",
    "demo": "eval.commands.demo:demo",
    "eval": "eval.commands.eval:evaluate",
    "report": "eval.commands.report:report",
    "samples": "eval.commands.samples:samples",
    "study": "eval.commands.study:STUDY",
}
STAGES = {"evaluator": "eval.native_evaluator.stage:EVALUATOR", "tmr": "eval.native_evaluator.stage:TMR"}
ALL = ("evaluator",)
TABLES = {
    "nerm-1": "eval.tables.nerm.table1:TABLE",
    "nerm-2": "eval.tables.nerm.table2:TABLE",
    "nerm-3": "eval.tables.nerm.table3:TABLE",
    "nerm-4": "eval.tables.nerm.reconstruction:TABLE_4",
    "nerm-5": "eval.tables.nerm.reconstruction:TABLE_5",
    "nerm-6": "eval.tables.nerm.reconstruction:TABLE_6",
    "nerm-7": "eval.tables.nerm.reconstruction:TABLE_7",
    "nerm-8": "eval.tables.nerm.reconstruction:TABLE_8",
    "nerm-9": "eval.tables.nerm.reconstruction:TABLE_9",
    "nerm-figure5": "eval.tables.nerm.figures:FIGURE_5",
    "nerm-figure8": "eval.tables.nerm.figures:FIGURE_8",
    "nerm-ours": "eval.tables.nerm.reconstruction:TABLE_OURS",
    "nerm-physical": "eval.tables.physical:TABLE",
    "pahires-1": "eval.tables.pahires:TABLE_1",
    "pahires-2": "eval.tables.pahires:TABLE_2",
    "pahires-3": "eval.tables.pahires:TABLE_3",
    "pahires-4": "eval.tables.pahires:TABLE_4",
    "pahires-extrapolation": "eval.tables.pahires:TABLE_EXTRAPOLATION",
    "pahires-figure5": "eval.tables.pahires:FIGURE_5",
    "pahires-figure6": "eval.tables.pahires:FIGURE_6",
}
# What `motionkit train --for KIND:NAME` trains, by KIND.
PLANS = dict.fromkeys(("table", "figure"), "eval.tables.table:plan")
