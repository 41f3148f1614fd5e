#ifndef IMUCAL_CALIBRATION_LOADER_H
#define IMUCAL_CALIBRATION_LOADER_H

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

#define IMUCAL_MAX_EFFECTS 12
#define IMUCAL_MAX_PARAMETERS 18
/* Size of the longest binary form of a calibration, bytes. */
#define IMUCAL_LONGEST_BLOB (128 + IMUCAL_MAX_EFFECTS * (8 + 4 * IMUCAL_MAX_PARAMETERS))

/* Results of imucal_calibration_load. */
#define IMUCAL_LOADED 0
#define IMUCAL_TOO_SHORT (-1)
#define IMUCAL_NO_CALIBRATION (-2) /* the bytes are no calibration, for example erased memory */
#define IMUCAL_OTHER_VERSION (-3)
#define IMUCAL_DAMAGED (-4)        /* the checksum is wrong */
#define IMUCAL_UNKNOWN_EFFECT (-5) /* the calibration has an effect that this older header does not know */
#define IMUCAL_BAD_CONTENT (-6)

/* Results of imucal_correct. Warnings are positive and may be added. After an error, which is negative, the corrected
 * sample is NaN. */
#define IMUCAL_CORRECTED 0
#define IMUCAL_TEMPERATURE_LIMITED 1 /* the temperature was clamped to the range of the calibration's recordings */
#define IMUCAL_INPUT_MISSING 2       /* an input of an effect is unknown, so this part of the error was not removed */
#define IMUCAL_NOT_INVERTIBLE (-1)   /* the effects are so large at this sample that the iteration did not converge */
#define IMUCAL_NOT_COUNTS (-2)       /* imucal_correct_counts was called with a calibration of SI units */

/* Inputs that an effect may need, in imucal_calibration.needs. */
#define IMUCAL_NEEDS_TEMPERATURE 1
#define IMUCAL_NEEDS_TIME 2
#define IMUCAL_NEEDS_ACCELERATION 4
#define IMUCAL_NEEDS_TEMPERATURE_HISTORY 8

typedef struct {
    float inverse[3][3];
    float bias[3];
} imucal_triad;

typedef struct {
    uint8_t number;
    uint8_t count;
    float shape;
    float values[IMUCAL_MAX_PARAMETERS];
} imucal_effect;

typedef struct {
    imucal_triad gyroscope;
    imucal_triad accelerometer;
    imucal_effect effects[IMUCAL_MAX_EFFECTS];
    uint8_t effect_count;
    uint8_t omitted_effects; /* number of effects that the binary form omits; their errors are not removed */
    uint8_t needs;           /* sum of IMUCAL_NEEDS_... */
    uint8_t rate_in_counts;
    uint8_t force_in_counts;
    uint8_t has_temperature_range;
    uint8_t axis[3];    /* index of the axis of the body frame that gives component i of a corrected sample */
    float axis_sign[3]; /* sign by which this component is multiplied; NaN until a calibration is loaded */
    float lowest_degc;
    float highest_degc;
    float reference_degc;
} imucal_calibration;

/* History of the temperature, updated by imucal_temperature_update. It must be all zeros before the first update. */
typedef struct {
    int started;
    float last_k, first_lag_k, second_lag_k; /* state of the low-passes that suppress the noise of the thermometer */
    float direction;                         /* from -1 (cooling) to 1 (heating) */
    float rate_kps;
    float gyro_lag_k, accel_lag_k;           /* low-passed minus present temperature, for the lag of each sensor */
} imucal_temperature;

/* Quantities other than rate and force on which effects may depend. An unknown quantity is NAN. */
typedef struct {
    float temperature_degc;
    /* Time since power-on. In the recordings of the calibration, the time is 0 at the first sample. */
    float time_s;
    float angular_acceleration_radps2[3]; /* in the body frame, from imucal_differentiate */
    const imucal_temperature *temperature_history; /* NULL if it is unknown */
} imucal_surroundings;

/* State of imucal_differentiate. Its initial value is IMUCAL_DERIVATIVE_START. */
typedef struct {
    float rate[3];
    float acceleration[3];
    int started;
} imucal_derivative;

#define IMUCAL_DERIVATIVE_START {{0, 0, 0}, {0, 0, 0}, 0}

static inline imucal_surroundings imucal_surroundings_unknown(void)
{
    imucal_surroundings unknown;
    unknown.temperature_degc = unknown.time_s = NAN;
    unknown.angular_acceleration_radps2[0] = NAN;
    unknown.angular_acceleration_radps2[1] = NAN;
    unknown.angular_acceleration_radps2[2] = NAN;
    unknown.temperature_history = NULL;
    return unknown;
}

static inline uint32_t imucal_uint32(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static inline float imucal_float(const uint8_t *at)
{
    const uint32_t bits = imucal_uint32(at);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Reads floats. Returns 0 if a float is not finite. */
static inline int imucal_floats(const uint8_t *at, float *values, int count)
{
    int i, finite = 1;
    for (i = 0; i < count; ++i) {
        values[i] = imucal_float(at + 4 * i);
        /* NaN fails both comparisons. */
        finite = finite && values[i] <= FLT_MAX && values[i] >= -FLT_MAX;
    }
    return finite;
}

static inline uint32_t imucal_crc32(const uint8_t *bytes, size_t size)
{
    uint32_t crc = 0xFFFFFFFFu;
    size_t i;
    int bit;
    for (i = 0; i < size; ++i) {
        crc ^= bytes[i];
        for (bit = 0; bit < 8; ++bit) crc = crc & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return crc ^ 0xFFFFFFFFu;
}

/* Largest identification number of an effect. */
#define IMUCAL_LAST_EFFECT 31

/* For the identification number of an effect: number of parameters of its plain form, number of parameters of its full
 * form, sum of the IMUCAL_NEEDS_... of its inputs, and whether it has a shape parameter. The first entry is 0 if no
 * effect has this number. */
static inline const uint8_t *imucal_effect_row(const imucal_effect *effect)
{
    static const uint8_t rows[IMUCAL_LAST_EFFECT + 1][4] = {
        {0, 0, 0, 0}, {9, 9, 0, 0}, {9, 18, 0, 0}, {3, 3, 0, 0}, {3, 3, 0, 0}, {3, 3, 0, 0}, {3, 3, 0, 0}, {9, 9, 0, 0},
        {3, 3, 0, 0}, {3, 3, 0, 0}, {3, 3, 0, 0}, {15, 15, 0, 0}, {3, 9, 1, 0}, {3, 9, 1, 0}, {3, 9, 1, 0}, {3, 9, 1, 0},
        {3, 3, 2, 0}, {3, 3, 2, 1}, {3, 3, 2, 0}, {3, 3, 2, 0}, {3, 3, 2, 1}, {9, 9, 4, 0}, {1, 1, 4, 0}, {0, 0, 0, 0},
        {3, 3, 4, 0}, {6, 6, 4, 0}, {3, 9, 9, 1}, {3, 9, 9, 0}, {3, 9, 9, 0}, {3, 9, 9, 1}, {3, 9, 9, 0}, {3, 9, 9, 0},
    };
    return rows[effect->number <= IMUCAL_LAST_EFFECT ? effect->number : 0];
}

/* Adds the inputs that an effect needs to `needs`. Returns 0 if the effect is unknown. */
static inline int imucal_effect_known(const imucal_effect *effect, uint8_t *needs)
{
    const uint8_t *const row = imucal_effect_row(effect);
    *needs |= row[2];
    return row[0] != 0;
}

/* Whether the effect has a valid number of parameters and a valid shape parameter. Valid numbers of parameters are the
 * multiples of the number of the plain form, up to the number of the full form. */
static inline int imucal_effect_counts(const imucal_effect *effect)
{
    const uint8_t *const row = imucal_effect_row(effect);
    return effect->count > 0 && effect->count <= row[1] && effect->count % row[0] == 0 &&
           (row[3] == 0 || effect->shape > 0);
}

/* Returns 0 if the matrix is singular. */
static inline int imucal_has_inverse(const imucal_triad *triad)
{
    const float(*const m)[3] = triad->inverse;
    const float determinant = m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) -
                              m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0]) +
                              m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0]);
    return determinant > 0 || determinant < 0;
}

/* Reads the binary form of a calibration. Bytes after its end are ignored. Returns IMUCAL_LOADED, or an error. After an
 * error the calibration must not be used. */
static inline int imucal_calibration_load(imucal_calibration *calibration, const void *bytes, size_t size)
{
    const uint8_t *const all = (const uint8_t *)bytes;
    size_t length, at = 124;
    int i;
    memset(calibration, 0, sizeof *calibration);
    for (i = 0; i < 3; ++i) calibration->axis_sign[i] = NAN;
    if (size < 8) return IMUCAL_TOO_SHORT;
    if (memcmp(all, "IMUC", 4) != 0) return IMUCAL_NO_CALIBRATION;
    if (all[4] != 1) return IMUCAL_OTHER_VERSION;
    length = (size_t)all[6] | (size_t)all[7] << 8;
    if (length > size || length < 128) return IMUCAL_TOO_SHORT;
    length -= 4;
    if (imucal_crc32(all, length) != imucal_uint32(all + length)) return IMUCAL_DAMAGED;
    calibration->rate_in_counts = all[5] & 1u ? 1 : 0;
    calibration->force_in_counts = all[5] & 2u ? 1 : 0;
    calibration->has_temperature_range = all[5] & 4u ? 1 : 0;
    calibration->effect_count = all[8];
    calibration->omitted_effects = all[9];
    if (calibration->effect_count > IMUCAL_MAX_EFFECTS) return IMUCAL_BAD_CONTENT;
    calibration->lowest_degc = imucal_float(all + 16);
    calibration->highest_degc = imucal_float(all + 20);
    calibration->reference_degc = imucal_float(all + 24);
    if (calibration->has_temperature_range &&
        !(calibration->lowest_degc <= calibration->highest_degc && calibration->lowest_degc >= -FLT_MAX &&
          calibration->highest_degc <= FLT_MAX))
        return IMUCAL_BAD_CONTENT;
    if (!imucal_floats(all + 24, &calibration->reference_degc, 1) ||
        !imucal_floats(all + 28, &calibration->gyroscope.inverse[0][0], 9) ||
        !imucal_floats(all + 64, calibration->gyroscope.bias, 3) ||
        !imucal_floats(all + 76, &calibration->accelerometer.inverse[0][0], 9) ||
        !imucal_floats(all + 112, calibration->accelerometer.bias, 3) ||
        !imucal_has_inverse(&calibration->gyroscope) ||
        !imucal_has_inverse(&calibration->accelerometer))
        return IMUCAL_BAD_CONTENT;
    for (i = 0; i < calibration->effect_count; ++i) {
        imucal_effect *const effect = &calibration->effects[i];
        if (length - at < 8) return IMUCAL_BAD_CONTENT;
        effect->number = all[at];
        effect->count = all[at + 1];
        effect->shape = imucal_float(all + at + 4);
        at += 8;
        if (!imucal_effect_known(effect, &calibration->needs)) return IMUCAL_UNKNOWN_EFFECT;
        if (!(effect->shape <= FLT_MAX) || !imucal_effect_counts(effect)) return IMUCAL_BAD_CONTENT;
        if (length - at < 4u * effect->count || !imucal_floats(all + at, effect->values, effect->count))
            return IMUCAL_BAD_CONTENT;
        at += 4u * effect->count;
    }
    if (at != length) return IMUCAL_BAD_CONTENT;
    for (i = 0; i < 3; ++i) {
        const uint8_t code = all[10 + i], axis = code < 128 ? code : (uint8_t)(256 - code);
        if (axis < 1 || axis > 3) return IMUCAL_BAD_CONTENT;
        calibration->axis[i] = (uint8_t)(axis - 1);
    }
    if (calibration->axis[0] == calibration->axis[1] || calibration->axis[0] == calibration->axis[2] ||
        calibration->axis[1] == calibration->axis[2])
        return IMUCAL_BAD_CONTENT;
    for (i = 0; i < 3; ++i) calibration->axis_sign[i] = all[10 + i] < 128 ? 1.0f : -1.0f;
    return IMUCAL_LOADED;
}

/* on += diag(values) (x, y, z) */
static inline void imucal_axes(float on[3], const float *values, float x, float y, float z)
{
    on[0] += values[0] * x;
    on[1] += values[1] * y;
    on[2] += values[2] * z;
}

/* on += M (x, y, z). Row i of M is the three numbers that start at values[stride * i]. */
static inline void imucal_entries(float on[3], const float *values, int stride, float x, float y, float z)
{
    int i;
    for (i = 0; i < 3; ++i) on[i] += values[stride * i] * x + values[stride * i + 1] * y + values[stride * i + 2] * z;
}

/* Adds the errors that an effect adds to the true rate and force (docs/model.md (15)) to on_w and on_f. d is the
 * temperature minus the reference temperature, K, h the history of the temperature, t the time, s, and a the angular
 * acceleration. Unknown quantities are 0. */
static inline void imucal_effect_at(const imucal_effect *effect, const float w[3], const float f[3], float d,
                                    const imucal_temperature *h, float t, int has_time, const float a[3],
                                    float on_w[3], float on_f[3])
{
    const float *const v = effect->values;
    float cold, power;
    int i;
    switch (effect->number) {
    case 1: imucal_entries(on_w, v, 3, f[0], f[1], f[2]); break;
    case 2:
        imucal_entries(on_w, v, 3, f[0] * f[0], f[1] * f[1], f[2] * f[2]);
        if (effect->count == 18) imucal_entries(on_w, v + 9, 3, f[1] * f[2], f[0] * f[2], f[0] * f[1]);
        break;
    case 3: imucal_axes(on_w, v, w[0] * f[0], w[1] * f[1], w[2] * f[2]); break;
    case 4: imucal_axes(on_w, v, w[0] * w[0], w[1] * w[1], w[2] * w[2]); break;
    case 5: imucal_axes(on_w, v, w[0] * w[0] * w[0], w[1] * w[1] * w[1], w[2] * w[2] * w[2]); break;
    case 6: imucal_axes(on_w, v, fabsf(w[0]), fabsf(w[1]), fabsf(w[2])); break;
    case 7: imucal_entries(on_w, v, 3, w[1] * w[2], w[0] * w[2], w[0] * w[1]); break;
    case 8: imucal_axes(on_f, v, f[0] * f[0], f[1] * f[1], f[2] * f[2]); break;
    case 9: imucal_axes(on_f, v, f[0] * f[0] * f[0], f[1] * f[1] * f[1], f[2] * f[2] * f[2]); break;
    case 10: imucal_axes(on_f, v, fabsf(f[0]), fabsf(f[1]), fabsf(f[2])); break;
    case 11:
        on_f[0] += v[0] * f[1] * f[1] + v[1] * f[2] * f[2];
        on_f[1] += v[5] * f[0] * f[0] + v[6] * f[2] * f[2];
        on_f[2] += v[10] * f[0] * f[0] + v[11] * f[1] * f[1];
        imucal_entries(on_f, v + 2, 5, f[1] * f[2], f[0] * f[2], f[0] * f[1]);
        break;
    case 12: case 14:
        for (i = 0, power = d; i < effect->count; i += 3, power *= d)
            imucal_axes(effect->number == 12 ? on_w : on_f, v + i, power, power, power);
        break;
    case 13:
        for (i = 0, power = d; i < effect->count; i += 3, power *= d)
            imucal_axes(on_w, v + i, w[0] * power, w[1] * power, w[2] * power);
        break;
    case 15:
        for (i = 0, power = d; i < effect->count; i += 3, power *= d)
            imucal_axes(on_f, v + i, f[0] * power, f[1] * power, f[2] * power);
        break;
    case 26: case 27: case 28: case 29: case 30: case 31:
        power = effect->number == 26   ? h->gyro_lag_k
                : effect->number == 29 ? h->accel_lag_k
                : effect->number == 28 || effect->number == 31 ? h->direction : h->rate_kps;
        for (i = 0; i < effect->count; i += 3, power *= d)
            imucal_axes(effect->number <= 28 ? on_w : on_f, v + i, power, power, power);
        break;
    case 16: imucal_axes(on_w, v, t, t, t); break;
    case 19: imucal_axes(on_f, v, t, t, t); break;
    case 17: case 20:
        /* If the time is unknown, the warm-up is assumed to be over, so its error is 0. */
        cold = has_time ? expf(-t / effect->shape) : 0.0f;
        imucal_axes(effect->number == 17 ? on_w : on_f, v, cold, cold, cold);
        break;
    case 18: imucal_axes(on_w, v, w[0] * t, w[1] * t, w[2] * t); break;
    case 21: imucal_entries(on_w, v, 3, a[0], a[1], a[2]); break;
    case 22:
        for (i = 0; i < 3; ++i) on_w[i] -= v[0] * a[i];
        break;
    case 24: case 25: {
        /* The rows of L. The acceleration at the lever arm r is dw/dt x r + w x (w x r) = L r. */
        const float x[3] = {-w[2] * w[2] - w[1] * w[1], w[0] * w[1] - a[2], w[0] * w[2] + a[1]};
        const float y[3] = {w[0] * w[1] + a[2], -w[2] * w[2] - w[0] * w[0], w[1] * w[2] - a[0]};
        const float z[3] = {w[0] * w[2] - a[1], w[1] * w[2] + a[0], -w[1] * w[1] - w[0] * w[0]};
        const float *const of_z = effect->number == 24 ? v : v + 3;
        if (effect->number == 24) on_f[0] += x[0] * v[0] + x[1] * v[1] + x[2] * v[2];
        on_f[1] += y[0] * v[0] + y[1] * v[1] + y[2] * v[2];
        on_f[2] += z[0] * of_z[0] + z[1] * of_z[1] + z[2] * of_z[2];
        break;
    }
    default: break;
    }
}

static inline void imucal_apply_triad(const imucal_triad *triad, const float raw[3], float seen[3])
{
    const float x = raw[0] - triad->bias[0], y = raw[1] - triad->bias[1], z = raw[2] - triad->bias[2];
    int i;
    for (i = 0; i < 3; ++i) seen[i] = triad->inverse[i][0] * x + triad->inverse[i][1] * y + triad->inverse[i][2] * z;
}

static inline float imucal_size(const float v[3])
{
    float size = 0;
    int i;
    for (i = 0; i < 3; ++i) {
        if (v[i] > size) size = v[i];
        if (-v[i] > size) size = -v[i];
    }
    return size;
}

/* Corrects one sample. The results are the rate in rad/s and the force in m/s^2, along the axes of the calibration. The
 * output arrays may be the input arrays. `surroundings` may be NULL if no quantity is known. Returns IMUCAL_CORRECTED,
 * a sum of warnings (positive), or an error (negative). After an error the results are NaN. */
static inline int imucal_correct(const imucal_calibration *calibration, const float raw_rate[3],
                                 const float raw_force[3], const imucal_surroundings *surroundings, float rate[3],
                                 float force[3])
{
    float seen_w[3], seen_f[3], w[3], f[3], a[3] = {0, 0, 0}, d = 0, t = 0;
    static const imucal_temperature constant = {0, 0, 0, 0, 0, 0, 0, 0};
    const imucal_temperature *history = &constant;
    int i, k, pass, has_time = 0, known = 0, result = IMUCAL_CORRECTED;
    imucal_apply_triad(&calibration->gyroscope, raw_rate, seen_w);
    imucal_apply_triad(&calibration->accelerometer, raw_force, seen_f);
    for (i = 0; i < 3; ++i) {
        w[i] = seen_w[i];
        f[i] = seen_f[i];
    }
    if (calibration->effect_count > 0) {
        if (surroundings != NULL) {
            float degc = surroundings->temperature_degc;
            const float *const given = surroundings->angular_acceleration_radps2;
            if (!isnan(degc)) {
                known |= IMUCAL_NEEDS_TEMPERATURE;
                if (calibration->has_temperature_range && (calibration->needs & IMUCAL_NEEDS_TEMPERATURE)) {
                    if (degc < calibration->lowest_degc || degc > calibration->highest_degc)
                        result |= IMUCAL_TEMPERATURE_LIMITED;
                    if (degc < calibration->lowest_degc) degc = calibration->lowest_degc;
                    if (degc > calibration->highest_degc) degc = calibration->highest_degc;
                }
                d = degc - calibration->reference_degc;
                if (surroundings->temperature_history != NULL) {
                    known |= IMUCAL_NEEDS_TEMPERATURE_HISTORY;
                    history = surroundings->temperature_history;
                }
            }
            if (!isnan(surroundings->time_s)) {
                known |= IMUCAL_NEEDS_TIME;
                has_time = 1;
                t = surroundings->time_s;
            }
            if (!isnan(given[0]) && !isnan(given[1]) && !isnan(given[2])) {
                known |= IMUCAL_NEEDS_ACCELERATION;
                for (i = 0; i < 3; ++i) a[i] = given[i];
            }
        }
        if (calibration->needs & ~known) result |= IMUCAL_INPUT_MISSING;
        /* Iteration true <- seen - effects(true), until only rounding errors change (docs/model.md (16)). `seen` is the
         * sample after the correction of bias and sensitivity. */
        for (pass = 0; pass < 32; ++pass) {
            float on_w[3] = {0, 0, 0}, on_f[3] = {0, 0, 0}, limit_w, limit_f;
            int settled = 1;
            for (k = 0; k < calibration->effect_count; ++k)
                imucal_effect_at(&calibration->effects[k], w, f, d, history, t, has_time, a, on_w, on_f);
            limit_w = 16 * FLT_EPSILON * (imucal_size(seen_w) + imucal_size(on_w));
            limit_f = 16 * FLT_EPSILON * (imucal_size(seen_f) + imucal_size(on_f));
            for (i = 0; i < 3; ++i) {
                const float next_w = seen_w[i] - on_w[i], next_f = seen_f[i] - on_f[i];
                /* Comparisons with NaN are false, so NaN never counts as settled. */
                settled = settled && fabsf(next_w - w[i]) <= limit_w && fabsf(next_f - f[i]) <= limit_f;
                w[i] = next_w;
                f[i] = next_f;
            }
            if (settled && limit_w <= FLT_MAX && limit_f <= FLT_MAX) break;
        }
        if (pass == 32) {
            for (i = 0; i < 3; ++i) rate[i] = force[i] = NAN;
            return IMUCAL_NOT_INVERTIBLE;
        }
    }
    for (i = 0; i < 3; ++i) {
        rate[i] = calibration->axis_sign[i] * w[calibration->axis[i]];
        force[i] = calibration->axis_sign[i] * f[calibration->axis[i]];
    }
    return result;
}

/* The same as imucal_correct, for raw samples of the sensor in 16-bit counts. */
static inline int imucal_correct_counts(const imucal_calibration *calibration, const int16_t raw_rate[3],
                                        const int16_t raw_force[3], const imucal_surroundings *surroundings,
                                        float rate[3], float force[3])
{
    float counts_rate[3], counts_force[3];
    int i;
    for (i = 0; i < 3; ++i) {
        counts_rate[i] = raw_rate[i];
        counts_force[i] = raw_force[i];
    }
    if (!calibration->rate_in_counts || !calibration->force_in_counts) {
        for (i = 0; i < 3; ++i) rate[i] = force[i] = NAN;
        return IMUCAL_NOT_COUNTS;
    }
    return imucal_correct(calibration, counts_rate, counts_force, surroundings, rate, force);
}

/* Returns the lag of a low-pass, which is its output minus the temperature, after a time step in which the temperature
 * changes linearly by change_k. `lag_k` is the lag before the time step. */
static inline float imucal_lag(float lag_k, float tau_s, float time_step_s, float change_k)
{
    const float step = time_step_s / tau_s, settled = -expm1f(-step), share = step > 0 ? settled / step : 1.0f;
    return lag_k - settled * lag_k - change_k * share;
}

/* Updates the temperature history with a reading of the thermometer (docs/model.md (43)). time_step_s is the time since
 * the previous reading. Do not call this function for readings that are not finite. imucal_correct reads the history
 * through surroundings->temperature_history. */
static inline void imucal_temperature_update(const imucal_calibration *calibration, imucal_temperature *memory,
                                             float time_step_s, float temperature_degc)
{
    const float smoothing_s = 0.5f, reversal_k = 1.0f, now_k = temperature_degc - calibration->reference_degc;
    const float change_k = memory->started ? now_k - memory->last_k : 0, before_k = memory->first_lag_k;
    const float step = time_step_s / smoothing_s, second_before_k = memory->second_lag_k;
    float turned;
    int k;
    memory->last_k = now_k;
    memory->started = 1;
    for (k = 0; k < calibration->effect_count; ++k) {
        const imucal_effect *const effect = &calibration->effects[k];
        if (effect->number == 26)
            memory->gyro_lag_k = imucal_lag(memory->gyro_lag_k, effect->shape, time_step_s, change_k);
        if (effect->number == 29)
            memory->accel_lag_k = imucal_lag(memory->accel_lag_k, effect->shape, time_step_s, change_k);
    }
    memory->first_lag_k = imucal_lag(before_k, smoothing_s, time_step_s, change_k);
    if (step > 0) {
        const float settled = -expm1f(-step), steady_k = -change_k / step;
        memory->second_lag_k = memory->second_lag_k - settled * memory->second_lag_k + steady_k * settled +
                               (before_k - steady_k) * step * (1 - settled);
    }
    memory->rate_kps = -memory->second_lag_k / smoothing_s;
    turned = memory->direction +
             (change_k + (memory->first_lag_k - before_k) - (memory->second_lag_k - second_before_k)) / reversal_k;
    memory->direction = turned > 1 ? 1 : turned < -1 ? -1 : turned;
}

/* Computes the angular acceleration, rad/s^2 in the body frame, from the corrected rates of consecutive samples. `rate`
 * is a result of imucal_correct, and dt_s the time since the previous sample. The angular acceleration is an input of
 * imucal_correct for the next sample. A filter with a time constant of 20 ms suppresses the noise and delays the
 * angular acceleration by 20 ms. */
static inline void imucal_differentiate(const imucal_calibration *calibration, imucal_derivative *state, float dt_s,
                                        const float rate[3], float angular_acceleration_radps2[3])
{
    const float share = dt_s / (0.02f + dt_s);
    float body[3] = {0, 0, 0};
    int i;
    for (i = 0; i < 3; ++i) body[calibration->axis[i]] = calibration->axis_sign[i] * rate[i];
    for (i = 0; i < 3; ++i) {
        if (state->started && dt_s > 0)
            state->acceleration[i] += share * ((body[i] - state->rate[i]) / dt_s - state->acceleration[i]);
        state->rate[i] = body[i];
        angular_acceleration_radps2[i] = state->acceleration[i];
    }
    state->started = 1;
}

#ifdef __cplusplus
}
#endif

#endif
