"""Figure 2 under both readings of what the paper's experts were: neural or linear."""

import itertools
from collections import Counter

from ailsrs_jax.show.sweep_report import markdown_table
from experiments.claims import CLAIMS
from experiments.evidence import FEWEST, FIGURE_2, MOST, TASKS, Evidence, NotRunError, judge
from experiments.rules import share, short

LABELS = ("BC", "GAIL", "AILSRS")  # of Figure 2
VERDICTS = ("reproduced", "partly", "not", "not yet run")

ABOUT = """\
The paper does not say what its experts were. They may have been linear policies of random search,
as the method's own are. So Figure 2 has run twice: with neural experts, [paper](#paper), which the
verdicts above are about, and with linear ones, [paper_linear](#paper_linear), with the same
settings and with seeds 0 to 2 on each task. No setting was chosen with the linear experts. The
machine did light work beside them, so their times are less exact. The first table has shares of the
expert's return from ten and from forty demonstrations. The second one has the verdict on each claim
that Figure 2 decides under both readings. What the paper says of BC on Swimmer holds only with
neural experts, and what it says of Hopper holds better with linear ones. Under neither reading does
BC improve with more demonstrations, as the paper's does."""


def tables(neural: Evidence, linear: Evidence) -> list[str]:
    """Return the shares and the verdicts under both readings of what the experts were."""
    shares = []
    for task, number in itertools.product(TASKS, (FEWEST, MOST)):
        fields = [f"{short(task)} {number}"]
        for label, evidence in itertools.product(LABELS, (neural, linear)):
            try:
                fields.append(f"{share(evidence.group(label, task, number)):z.2f}")
            except NotRunError:
                fields.append("not yet run")
        shares.append(fields)
    of_neural, of_linear, rows = Counter[str](), Counter[str](), []
    for section, claims in CLAIMS.items():
        for claim in claims:
            if claim.sweep == FIGURE_2:
                (_, before), (ours, verdict) = judge(claim, neural), judge(claim, linear)
                of_neural[before] += 1
                of_linear[verdict] += 1
                part = section.removeprefix("Figure 2: ").partition(",")[0]
                rows.append([part, claim.text, before, f"**{verdict}**", ours])
    counts = (
        f"{len(rows)} claims. With neural experts: {summary(of_neural)}. "
        f"With linear experts: {summary(of_linear)}."
    )
    columns = [f"{label}, {kind}" for label in LABELS for kind in ("neural", "linear")]
    header = ["part", "claim", "neural experts", "linear experts", "ours, with linear experts"]
    return [markdown_table(["", *columns], shares), counts, markdown_table(header, rows)]


def summary(counts: Counter[str]) -> str:
    """Return how many claims have each verdict."""
    return ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
