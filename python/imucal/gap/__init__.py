"""Where recordings and model disagree, which effect is missing, what it is worth, and what would decide.

find             options, and the question that the compiled library answers
question         the recordings, the options, and the call
translation      from what the library finds to the result
result           the result
notes, text      sentences on it
motion_library, next_motion     the motion that would decide between rivals
"""

from imucal.gap.find import find_gap
from imucal.gap.result import Gap

__all__ = ["Gap", "find_gap"]
