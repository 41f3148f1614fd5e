/* The C header of one unit (c-header). */
#include "unit.h"

static int start_correction(void) { return 0; }

__attribute__((noinline)) static void correct(float *rate, float *force)
{
    imucal_correct_f32(rate, force, ARGUMENTS rate, force);
}
