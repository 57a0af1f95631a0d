"""Reads BDDL files: the objects of a task, their initial places and the goal."""

from __future__ import annotations

import ast
import operator
import os
import re
from typing import Any, TypedDict, Union

# An expression: a word, or a list of expressions.
_Expression = Union[str, "list[_Expression]"]


class ProblemInfo(TypedDict):
    """Problem, domain and instruction of a file."""

    problem_name: str
    domain_name: str
    language_instruction: str


def scan_tokens(filename: str | os.PathLike[str] | None = None, string: str | None = None) -> Any:
    """Parses a BDDL file or text into nested lists of words in lower case. Raises ValueError unless
    it is one definition with matching parentheses."""
    if filename is not None:
        with open(filename, encoding="utf-8") as file:
            string = file.read()
    if string is None:
        raise ValueError("there is no BDDL to read: give filename or string")
    where = os.fspath(filename) if filename is not None else "the text"
    text = re.sub(r";.*$", "", string, flags=re.MULTILINE).lower()
    open_lists: list[list[_Expression]] = [[]]
    for token in re.findall(r"[()]|[^\s()]+", text):
        if token == "(":
            open_lists.append([])
        elif token != ")":
            open_lists[-1].append(token)
        elif len(open_lists) > 1:
            closed = open_lists.pop()
            open_lists[-1].append(closed)
        else:
            raise ValueError(f"{where} closes a parenthesis that it never opened")
    if len(open_lists) > 1:
        raise ValueError(f"{where} leaves a parenthesis open")
    if len(open_lists[0]) != 1:
        raise ValueError(f"{where} is not one BDDL definition")
    return open_lists[0][0]


def get_problem_info(problem_filename: str | os.PathLike[str]) -> ProblemInfo:
    """Returns the problem, domain and instruction of a file, all in lower case."""
    sections = _sections(problem_filename)
    # As in LIBERO, the domain is robosuite's whatever it is called.
    return {
        "problem_name": sections.get("problem", ["unknown"])[-1],
        "domain_name": "robosuite" if ":domain" in sections else "unknown",
        "language_instruction": " ".join(sections.get(":language", [])),
    }


def robosuite_parse_problem(problem_filename: str | os.PathLike[str]) -> dict[str, Any]:
    """Returns the whole contents of a file, with LIBERO's keys.

    `fixtures` and `objects` map a category to its instances. `regions` maps `TARGET_REGION` to the
    region's target, ranges (smallest x and y, largest x and y, m), rotation (rad) and colour.
    `initial_state` and `goal_state` list predicates with their arguments."""
    sections = _sections(problem_filename)
    domain = sections.get(":domain", ["robosuite"])[-1]
    if domain != "robosuite":
        raise ValueError(
            f"{os.fspath(problem_filename)} is of the domain `{domain}`: only robosuite's is known"
        )
    goal: list[Any] = []
    for expression in sections.get(":goal", []):
        goal += expression[1:] if expression[0] == "and" else [expression]
    return {
        "problem_name": sections.get("problem", ["unknown"])[-1],
        "fixtures": _by_category(sections.get(":fixtures", []), "fixture"),
        "regions": dict(_region(region) for region in sections.get(":regions", [])),
        "objects": _by_category(sections.get(":objects", []), "object"),
        "scene_properties": {},
        "initial_state": sections.get(":init", []),
        "goal_state": goal,
        "language_instruction": sections.get(":language", []),
        "obj_of_interest": sections.get(":obj_of_interest", []),
    }


def _sections(filename: str | os.PathLike[str]) -> dict[str, list[Any]]:
    definition = scan_tokens(filename=filename)
    if not isinstance(definition, list) or definition[:1] != ["define"]:
        raise ValueError(f"{os.fspath(filename)} does not define a problem")
    return {section[0]: section[1:] for section in definition[1:]}


def _by_category(words: list[str], default_category: str) -> dict[str, list[str]]:
    """Converts `a b - bowl c - plate` to bowl: a b, plate: c. Instances that no category follows get
    the default."""
    categories: dict[str, list[str]] = {}
    instances: list[str] = []
    words_left = iter(words)
    for word in words_left:
        if word == "-":
            categories[next(words_left)] = instances
            instances = []
        else:
            instances.append(word)
    if instances:
        categories.setdefault(default_category, []).extend(instances)
    return categories


def _region(expression: list[Any]) -> tuple[str, dict[str, Any]]:
    region: dict[str, Any] = {
        "target": None,
        "ranges": [],
        "extra": [],
        "yaw_rotation": [0, 0],
        "rgba": [0, 0, 1, 0],
    }
    for attribute in expression[1:]:
        match attribute:
            case [":target", target]:
                region["target"] = target
            case [":ranges", ranges]:
                region["ranges"] = [[float(x) for x in range_] for range_ in ranges]
            case [":yaw_rotation", rotations]:
                # As in LIBERO, the last rotation counts.
                region["yaw_rotation"] = [_number(x) for x in rotations[-1]]
            case [":rgba", colour]:
                region["rgba"] = [float(x) for x in colour]
            case _:
                raise ValueError(f"a region has an unknown attribute: {attribute}")
    return f"{region['target']}_{expression[0]}", region


_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def _number(expression: str) -> float:
    """Evaluates a rotation, which may be written as arithmetic with `pi`."""

    def value(node: ast.AST) -> float:
        match node:
            case ast.Constant(value=int() | float() as number):
                return number
            case ast.Name(id="pi") | ast.Attribute(attr="pi"):
                return 3.141592653589793
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return -value(operand)
            case ast.BinOp(left=left, op=symbol, right=right) if type(symbol) in _OPERATORS:
                return float(_OPERATORS[type(symbol)](value(left), value(right)))
        raise ValueError(f"a rotation is no number: {expression}")

    return value(ast.parse(expression, mode="eval").body)
