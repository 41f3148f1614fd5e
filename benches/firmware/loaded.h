/* The C header of any unit (c-loader) with the binary form of one (blob). */
#include "loader.h"
#include "blob.h"

static imucal_calibration unit;

static int start_correction(void) { return imucal_calibration_load(&unit, blob, sizeof blob); }

__attribute__((noinline)) static void correct(float *rate, float *force)
{
    imucal_surroundings at = imucal_surroundings_unknown();
    at.temperature_degc = 40.0f;
    imucal_correct(&unit, rate, force, &at, rate, force);
}
