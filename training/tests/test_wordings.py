"""Wordings are many and distinct, and exclude the wordings of the evaluation."""

import re

import pytest

from training import wordings
from training.grammar import FRAMES, TASKS
from training.wordings import TASK_NAMES, canonical, digest, draw, held_out_digests

COUNT = 1_500


@pytest.fixture(scope="module")
def drawn() -> dict[str, list[str]]:
    return {task: draw(task, COUNT, seed=5) for task in TASK_NAMES}


def test_there_are_forty_tasks_in_the_benchmarks_order() -> None:
    suites = ("libero_spatial", "libero_object", "libero_goal", "libero_10")
    assert TASK_NAMES == tuple(f"{suite}/{at}" for suite in suites for at in range(10))


def test_wordings_of_a_task_differ_and_begin_with_the_benchmarks_instruction(
    drawn: dict[str, list[str]],
) -> None:
    for task, texts in drawn.items():
        assert texts[0] == canonical(task)
        assert len({digest(text) for text in texts}) == COUNT


def test_no_two_tasks_share_a_wording(drawn: dict[str, list[str]]) -> None:
    owner: dict[str, str] = {}
    for task, texts in drawn.items():
        for text in texts:
            assert owner.setdefault(digest(text), task) == task, text


def test_a_seed_gives_the_same_wordings() -> None:
    assert draw("libero_goal/7", 50, seed=1) == draw("libero_goal/7", 50, seed=1)
    assert draw("libero_goal/7", 50, seed=1)[1:] != draw("libero_goal/7", 50, seed=2)[1:]


def test_wordings_contain_no_template_syntax(drawn: dict[str, list[str]]) -> None:
    for texts in drawn.values():
        for text in texts:
            assert not re.search(r"[\[\]{}|]|  |^ | $", text), text


def test_every_slot_can_be_filled() -> None:
    for task, (_, grammar) in TASKS.items():
        templates = [template for kind in FRAMES for template in (*FRAMES[kind], *grammar[kind])]
        for template in templates:
            for slot in re.findall(r"\{([^{}]+)\}", template):
                assert slot in grammar, f"{task}: {template}"


def test_more_wordings_than_the_grammar_has_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    grammar = {kind: ("turn on the stove",) for kind in FRAMES}
    monkeypatch.setattr(wordings, "TASKS", {"libero_goal/7": ("turn on the stove", grammar)})
    monkeypatch.setattr(wordings, "FRAMES", {kind: (f"{{{kind}}}",) for kind in FRAMES})
    with pytest.raises(ValueError, match="ask for fewer"):
        draw("libero_goal/7", 5, seed=0)


def test_no_wording_is_in_the_evaluation(drawn: dict[str, list[str]]) -> None:
    assert len(held_out_digests()) >= 1_000
    for texts in drawn.values():
        assert not held_out_digests() & {digest(text) for text in texts[1:]}


def test_held_out_digests_are_those_of_the_benchmark_rows(drawn: dict[str, list[str]]) -> None:
    pytest.importorskip("rollout_libero", reason="rollout_libero is not installed")
    from training.held_out import evaluation_sentences

    sentences = set(evaluation_sentences())
    assert {digest(text) for text in sentences} == held_out_digests()
    for texts in drawn.values():
        assert not sentences & set(texts[1:])


def test_canonical_instructions_are_those_of_the_benchmark() -> None:
    libero = pytest.importorskip("rollout_libero", reason="rollout_libero is not installed")
    assert {task.name: task.instruction for task in libero.tasks()} == {
        task: canonical(task) for task in TASK_NAMES
    }
