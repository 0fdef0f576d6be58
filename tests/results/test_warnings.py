"""Warnings in few words: one sentence for all that say the same, those that matter most first."""

from petalfit.results import FitWarning
from petalfit.results.warning import in_few_words, in_order
from tests.fitted import changed, known_pose

FREE = ("a_x", "b_y", "c", "dx")


def unknown(*names):
    return [
        FitWarning(f"{n} is not determined by this target", "not_determined", [n]) for n in names
    ]


def test_the_kind_decides_what_comes_first():
    odd = FitWarning("500 of 2,000 points coincide", "target")
    bound = FitWarning("a_x ended at the bound of its range (1, 100)", "at_bound", ["a_x"])
    few = FitWarning("25 % of the surface has no data", "coverage")
    warnings = in_order([bound, *unknown("dx"), few, odd, few])
    assert [str(warning.kind) for warning in warnings] == [
        "target",
        "coverage",
        "not_determined",
        "at_bound",
    ]


def test_parameters_share_a_sentence():
    assert in_few_words(unknown("a_x", "dx"), FREE) == [
        "2 of 4 parameters are not determined by this target: a_x and dx"
    ]
    assert in_few_words(unknown("dx"), FREE) == ["dx is not determined by this target"]
    assert in_few_words(unknown(*FREE), FREE) == [
        "none of the 4 parameters is determined by this target"
    ]
    # Those of a pose are not among the free ones of the model.
    assert in_few_words(unknown("dx", "turn_y"), FREE) == [
        "2 parameters are not determined by this target: dx and turn_y"
    ]


def test_bounds_and_combinations_share_one_too():
    bounds = [
        FitWarning(f"{n} ended at the bound of its range (1, {k})", "at_bound", [n])
        for k, n in enumerate(FREE)
    ]
    pairs = [
        FitWarning(f"{n} and scale are determined only as a product", "combination", [n, "scale"])
        for n in FREE
    ]
    assert in_few_words([*pairs, *bounds], FREE) == [
        "a_x, b_y, c and dx ended at the bounds of their ranges",
        "a_x and scale are determined only as a product, and there are 3 more such combinations",
    ]


def test_a_message_says_how_many_it_leaves_out():
    odd = [FitWarning(f"oddity {k}", "target") for k in range(5)]
    result = changed(known_pose(), warnings=tuple(odd))
    assert result.doubts == [*odd]
    assert result.message.endswith("oddity 0; oddity 1; oddity 2; 2 more warnings")
