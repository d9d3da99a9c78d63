"""Times training steps of gripcast's classifier in PyPI's torch and prints one JSON object.

    python3 benches/peers/torch_train.py - --runs 10 < DESCRIPTION.json

The description has `convolutions`, `pool`, `pooled`, `embedding`, `hidden`, `batch`, `threads`. Both
memory formats are measured; the faster one counts. Ends with code 3 when torch is absent.
"""

import argparse
import json
import sys
import time

try:
    import torch
    from torch import nn
except ImportError:
    sys.exit(3)

WARM_UP = 2


def encoder(description):
    layers, inputs = [], 3
    for conv in description["convolutions"]:
        outputs = conv["channels"]
        layers += [
            nn.Conv2d(inputs, outputs, conv["kernel"], conv["stride"], conv["pad"], bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        ]
        inputs = outputs
    pooled = 1
    for side in description["pooled"]:
        pooled *= side
    return nn.Sequential(
        *layers,
        nn.AvgPool2d(tuple(description["pool"])),
        nn.Flatten(),
        nn.Linear(pooled, description["embedding"]),
    )


class Classifier(nn.Module):
    def __init__(self, description):
        super().__init__()
        self.touch, self.vision = encoder(description), encoder(description)
        self.head = nn.Sequential(
            nn.Linear(3 * description["embedding"], description["hidden"]),
            nn.ReLU(),
            nn.Linear(description["hidden"], 1),
        )

    def forward(self, touch, vision):
        count = vision.shape[0]
        touched = self.touch(touch)
        return self.head(torch.cat([touched[:count], touched[count:], self.vision(vision)], 1))


def measured(description, runs, memory_format):
    """Samples per second of wall and of CPU time, medians."""
    torch.manual_seed(0)
    count = description["batch"]
    model = Classifier(description).to(memory_format=memory_format)
    touch = (torch.rand(2 * count, 3, 240, 320) - 0.5).contiguous(memory_format=memory_format)
    vision = (torch.rand(count, 3, 240, 320) - 0.5).contiguous(memory_format=memory_format)
    labels = (torch.arange(count) % 2).float()[:, None]
    optimiser = torch.optim.AdamW(model.parameters(), 3e-4)
    loss = nn.BCEWithLogitsLoss()
    wall, cpu = [], []
    for run in range(WARM_UP + runs):
        started = time.perf_counter(), time.process_time()
        optimiser.zero_grad()
        loss(model(touch, vision), labels).backward()
        optimiser.step()
        if run >= WARM_UP:
            wall.append(time.perf_counter() - started[0])
            cpu.append(time.process_time() - started[1])
    middle = (runs - 1) // 2
    return {
        "samples_per_s_median": count / sorted(wall)[middle],
        "samples_per_cpu_s_median": count / sorted(cpu)[middle],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("description")
    parser.add_argument("--runs", type=int, default=10)
    args = parser.parse_args()
    description = json.load(sys.stdin)
    torch.set_num_threads(description["threads"])
    found = {
        name: measured(description, args.runs, memory_format)
        for name, memory_format in [
            ("contiguous", torch.contiguous_format),
            ("channels_last", torch.channels_last),
        ]
    }
    best = max(found, key=lambda name: found[name]["samples_per_cpu_s_median"])
    json.dump(
        {**found[best], "memory_format": best, "all": found, "version": torch.__version__},
        sys.stdout,
        sort_keys=True,
    )
    print()


if __name__ == "__main__":
    main()
