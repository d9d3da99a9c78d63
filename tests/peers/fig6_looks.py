"""What `gripcast experiment fig6` does not print of the shifted set, from the predictions it keeps.

    python3 tests/peers/fig6_looks.py FIG6 [--seen PLAN]

V+T minus V+T trained on rigid bodies, and minus T: difference of AUROC (mean of seeds) with 95 %
and 97.5 % intervals over objects, on all objects and on those that are not in PLAN, the folder of
a plan whose objects were looked at before; and the best balanced accuracy in hindsight. Standard
library only; own bootstrap, so intervals differ from gripcast's in the third decimal.
"""

import argparse
import bisect
import json
import pathlib
import random

RESAMPLES = 2000


def predictions(fig6, condition):
    """For each seed, pairs (p_stable, stable) by object."""
    seeds = []
    for path in sorted((fig6 / condition).glob("seed-*/eval-shifted.json")):
        by_object = {}
        for sample in json.loads(path.read_text())["evaluation"]["predictions"]:
            pair = (sample["p_stable"], sample["stable"])
            by_object.setdefault(sample["object"], []).append(pair)
        seeds.append(by_object)
    if not seeds:
        raise SystemExit(f"{fig6 / condition} has no seed-*/eval-shifted.json")
    return seeds


def auroc(pairs):
    stable = [p for p, is_stable in pairs if is_stable]
    lost = sorted(p for p, is_stable in pairs if not is_stable)
    below = sum(bisect.bisect_left(lost, p) + bisect.bisect_right(lost, p) for p in stable)
    return below / 2 / len(stable) / len(lost)


def best_balanced_accuracy(pairs):
    pairs = sorted(pairs)
    stable = sum(is_stable for _, is_stable in pairs)
    lost = len(pairs) - stable
    kept, found = stable, 0
    best = 0.5
    for index, (p, is_stable) in enumerate(pairs):
        kept -= is_stable
        found += not is_stable
        # A threshold lies between different probabilities only.
        if index + 1 == len(pairs) or pairs[index + 1][0] != p:
            best = max(best, (kept / stable + found / lost) / 2)
    return best


def mean(seeds, objects, of):
    return sum(of([pair for name in objects for pair in seed[name]]) for seed in seeds) / len(seeds)


def difference(one, other, objects):
    at = lambda drawn: mean(one, drawn, auroc) - mean(other, drawn, auroc)
    rng = random.Random(0)
    drawn = sorted(at(rng.choices(objects, k=len(objects))) for _ in range(RESAMPLES))
    ends = lambda fraction: [drawn[round(q * (RESAMPLES - 1))] for q in (fraction / 2, 1 - fraction / 2)]
    print(f"  {len(objects)} objects: {at(objects):.3f}", end="")
    for level in (0.05, 0.025):
        low, high = ends(level)
        print(f"  {100 * (1 - level):g} % [{low:.3f}, {high:.3f}]", end="")
    print()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("fig6", type=pathlib.Path)
    parser.add_argument("--seen", type=pathlib.Path, help="folder of a plan looked at before")
    args = parser.parse_args()
    both, rigid, touch = (predictions(args.fig6, c) for c in ("vt", "vt-rigid", "t"))
    objects = sorted(both[0])
    sets = [objects]
    if args.seen:
        lines = (args.seen / "plan.jsonl").read_text().splitlines()
        kinds = [json.loads(line) for line in lines]
        seen = {record["name"] for record in kinds if record["kind"] == "object"}
        sets.append([name for name in objects if name not in seen])
    for title, other in (("V+T − V+T, rigid", rigid), ("V+T − T", touch)):
        print(f"{title}, AUROC")
        for names in sets:
            difference(both, other, names)
    print("balanced accuracy at the best threshold in hindsight")
    for title, seeds in (("V+T", both), ("V+T, rigid", rigid)):
        print(f"  {title}: {mean(seeds, objects, best_balanced_accuracy):.3f}")


main()
