"""What the notebooks of section 5.2 ask for in one call: the runs of a profile, what stored ones say in words."""

from dropout_uncertainty.active_learning.experiment import CONFIGS, POOL_ROWS, ROWS, units
from dropout_uncertainty.active_learning.report import analysis, peaks
from dropout_uncertainty.active_learning.report import pools as report
from dropout_uncertainty.active_learning.report.analysis import Row
from dropout_uncertainty.active_learning.report.statements import STATEMENTS
from dropout_uncertainty.page.profiles import computed
from dropout_uncertainty.page.tables import Words

#: Those on pools that have twenty repetitions; the others have ten.
TWENTY = {
    f"pools/{kind}/{row}"
    for kind, count in (("ambiguous", 4), ("clean", 3))
    for row in ("random", *POOL_ROWS[kind][:count])
}


def rows(profile: str) -> dict[str, Row]:
    """Return the rows of Tables 5.1 and 5.2, and others on the same pool; in ``quick`` short runs, checked."""
    quick = [unit for row in ROWS for unit in units(f"quick/{row}", [100])]
    names = [name for name in CONFIGS if name.startswith("early/")]  # of a primary statement, hence twenty
    full = [unit for seed in range(10) for row in ROWS for unit in units(f"ours/{row}", [seed])]
    full += [unit for seed in range(10, 20) for name in names for unit in units(name, [seed])]
    with computed(profile, quick, full) as folder:
        if folder is None:
            return analysis.load_rows("ours")
        found = analysis.load_rows("quick", folder, published=False)
        analysis.check_quick(found)
        return found


def original(profile: str) -> dict[str, Row] | None:
    """Return the curves of the original program; none in ``quick``, whose runs are too short to stand beside them."""
    return None if profile == "quick" else analysis.original_rows()


def peaks_in_tables() -> Words:
    """Return how high the peaks of the curves are, and what they change in the tables."""
    return Words(peaks.in_tables())


def threshold(profile: str) -> float:
    """Return the test error in % that Table 5.2 counts to; a higher one for the short runs of ``quick``."""
    return 20.0 if profile == "quick" else analysis.THRESHOLD


def pools(profile: str) -> dict[str, dict[str, Row]]:
    """Return the rows of each kind of pool; in ``quick`` short runs on one kind."""
    quick = [unit for name in CONFIGS if name.startswith("pools-quick/") for unit in units(name, [100])]
    names = [name for name in CONFIGS if name.startswith("pools/")]
    full = [unit for seed in range(20) for name in names if seed < 10 or name in TWENTY for unit in units(name, [seed])]
    with computed(profile, quick, full) as folder:
        return report.load() if folder is None else report.load("pools-quick", folder, published=False)


def verdicts(found: dict[str, dict[str, Row]]) -> tuple[list[str], list[list[object]]]:
    """Return heads and cells of the statements about pools, by the rules of the scoreboard."""
    return report.verdicts(found, {statement.id: statement for statement in STATEMENTS})
