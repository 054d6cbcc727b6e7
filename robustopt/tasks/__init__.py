"""Tasks that come with the package, as configurations."""

from pathlib import Path

PAPER_TASK = Path(__file__).parent / "paper_one_block.yaml"
"""The paper's one-block waiter task in simulation (section 6.3): mu is believed to be 1, and is 0.5."""
