/* Corrects the samples of the file `in` (six counts of 16 bits each) to the file `out` (six floats each) and writes the
 * ticks that this took, less those of an empty loop, to the file `ticks`. CORRECT is the code under test. */
#include "bare_metal.h"
#include <stdint.h>

#include CORRECT

#define BLOCK 32

int main(void)
{
    static int16_t in[BLOCK][6];
    static float out[BLOCK][6];
    const long from = host_open("in", 1), to = host_open("out", 5), report = host_open("ticks", 5);
    uint64_t total[2] = {0, 0};
    if (start_correction() != 0) return 1;
    while (host_read(from, in, sizeof in) == 0) {
        unsigned long before, spent;
        int i, k;
        before = ticks();
        for (i = 0; i < BLOCK; ++i)
            for (k = 0; k < 6; ++k) out[i][k] = in[i][k];
        spent = (ticks() - before) & TICKS;
        total[1] += spent;
        before = ticks();
        for (i = 0; i < BLOCK; ++i) {
            for (k = 0; k < 6; ++k) out[i][k] = in[i][k];
            correct(out[i], out[i] + 3);
        }
        spent = (ticks() - before) & TICKS;
        total[0] += spent;
        host_write(to, out, sizeof out);
    }
    host_write(report, total, sizeof total);
    return 0;
}
