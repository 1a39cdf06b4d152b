"""Robustness by rtamt, run by the interpreter that has it: formulas and signals as JSON in, robustness at 0 out."""

import json
import sys

import rtamt  # pyright: ignore[reportMissingImports]  (of another interpreter)

answers = []
for task in json.load(sys.stdin):
    monitor = rtamt.StlDiscreteTimeSpecification()
    for name in ("e", "u"):
        monitor.declare_var(name, "float")
    monitor.spec = task["text"]
    monitor.parse()
    columns = {name: task[name] for name in ("e", "u")}
    steps = len(columns["e"])
    answers.append(monitor.evaluate({"time": list(range(steps)), **columns})[0][1])
json.dump(answers, sys.stdout)
