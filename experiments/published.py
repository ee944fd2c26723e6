"""Published figures of other methods from one demonstration."""

from ailsrs_jax.show.sweep_report import markdown_table

ABOUT = """\
Shares of the expert's return from one whole trajectory, in version 4 of the tasks. They are the
figures of Chen et al., *Trust Region Reward Optimization and Proximal Inverse Reward Optimization
Algorithm* (NeurIPS 2025, arXiv 2509.23135). Chen et al. made all these runs, also those of GAIL;
none is ours. Their policies are networks, and they used other experts. Their whole trajectory can
have twenty times as many steps as our fifty transitions. So the table is no comparison. It shows
how hard it is to learn from one demonstration."""
TASKS = ["Ant", "Humanoid", "Walker2d", "Hopper", "HalfCheetah"]
SHARES = {
    "GAIL": ["0.17", "0.09", "0.75", "0.97", "0.11"],
    "DAC": ["0.16", "0.01", "0.00", "0.91", "0.79"],
    "IQ-Learn": ["0.61", "0.34", "0.55", "0.94", "0.31"],
    "HyPE": ["0.47", "0.13", "0.27", "0.71", "0.53"],
    "CSIL": ["0.07", "–", "0.12", "0.00", "0.00"],
    "ML-IRL": ["0.91", "1.01", "0.87", "0.91", "0.97"],
    "PIRO": ["1.01", "1.08", "1.02", "0.93", "1.03"],
}


def table() -> str:
    """Return the shares as Markdown."""
    rows = [[method, *shares] for method, shares in SHARES.items()]
    return markdown_table(["", *TASKS], rows)
