"""Damaged flower files: refused with a sentence, or a flower that can be saved."""

from pathlib import Path

import pytest

from petalfit.flowers import FlowerError, lily, load_flower, save_flower
from tests.mutations import damaged, each_case


@pytest.fixture(scope="module")
def flower(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("flower") / "flower.json"
    save_flower(lily(0), path)
    return path.read_bytes()


def attempt(content: bytes, folder: Path) -> None:
    (folder / "flower.json").write_bytes(content)
    try:
        read = load_flower(folder / "flower.json")
    except FlowerError as error:
        said = str(error)
    else:
        save_flower(read, folder / "again.json")
        load_flower(folder / "again.json")
        return
    assert said.startswith(str(folder / "flower.json"))


@pytest.mark.parametrize("seed", range(100))
def test_a_damaged_flower_is_refused_or_usable(seed, flower, tmp_path):
    attempt(damaged(flower, seed), tmp_path)


@pytest.mark.slow
def test_many_damaged_flowers_are_refused_or_usable(flower, tmp_path):
    for seed in range(100, 2100):
        attempt(damaged(flower, seed), tmp_path)


@each_case("flower*")
def test_flowers_that_were_seen_to_break(path, tmp_path):
    attempt(path.read_bytes(), tmp_path)
