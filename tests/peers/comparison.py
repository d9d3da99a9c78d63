"""What the scripts of this folder share: comparisons, and the faults that they find."""

faults = []


def expect(holds, what):
    """Notes `what` as a fault unless it holds."""
    expect.compared += 1
    if not holds:
        faults.append(what)


expect.compared = 0
