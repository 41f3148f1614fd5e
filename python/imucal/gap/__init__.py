"""Where recordings and model disagree, which effect is missing, what it is worth, and what would decide.

find             the search from end to end
trial            the recordings of a search; models of them, fitted and judged on what no fit has seen
rules            faults of the data, which come before any effect
verdict          what is said of what was found; `outcome` puts all figures beside it
residuals, paths, where, predicted_error, uncertainty     the disagreement, before and after
motion_library, next_motion     the motion that would decide what is open
result, text     the result, and its sentences
"""

from imucal.gap.find import find_gap
from imucal.gap.result import Gap

__all__ = ["Gap", "find_gap"]
