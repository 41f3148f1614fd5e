"""Find missing effects, their evidence and size, and a motion that distinguishes them from rivals.

A rival is another effect that explains the residuals about as well.

find             public function, checks of its arguments
question         input of a search for effects, and the call of the compiled library
translation      conversion of the compiled library's result to a `Gap`
result           the `Gap`
remainder        class for the residuals that the accepted effects do not explain
remaining        description of these residuals, from the result of the compiled library
own_motion       residuals at the rests and moves of the recordings, for pages and notebooks
sizes            conversion of the sizes of effects to the units of datasheets
notes, text      sentences about a result
soak             how the readings of a unit at rest in one pose depend on temperature
temperature_history             rate, direction and lag of the temperature
motion_library, next_motion     a motion that distinguishes between rivals
"""

from imucal.gap.find import find_gap
from imucal.gap.remainder import Remainder, SessionStep
from imucal.gap.result import Gap

__all__ = ["Gap", "Remainder", "SessionStep", "find_gap"]
