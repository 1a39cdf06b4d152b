/* The yardstick: a benchmark loop by hand, LANES draws at a time, a share of the draws a thread.

   benchmarks/speed/native.py writes numbers.h, compiles this file when it runs, and calls it through ctypes. numbers.h
   says BITS, LANES, PLANT (uav.h or axis.h), EULER, SAMPLE_TIME, and in NUMBERS all that the study is certain of: the
   compiler folds these, as XLA does. Draws are padded to a multiple of at_once(). */
#include <pthread.h>
#include <stdlib.h>

#include "numbers.h"

#include PLANT

#define AT_ONCE (GROUPS * LANES) /* draws that are simulated together */

typedef struct {
    const real *drawn; /* a row a number, a column a draw */
    const point *wanted;
    long samples, first, last; /* draws first .. last - 1 */
    results out;
} job;

static void *share(void *argument) {
    const job *j = argument;
    for (long at = j->first; at < j->last; at += AT_ONCE) simulate(j->drawn + at, j->wanted, j->samples, at, j->out);
    return NULL;
}

void run(const real *drawn, long samples, results out, int threads) {
    point *table = malloc(sizeof(point) * CHANNELS * samples); /* the trajectory, once for all draws */
    for (long k = 0; k < samples; k++)
        for (int i = 0; i < CHANNELS; i++) table[k * CHANNELS + i] = sine_at(&LOOP.wanted[i], (double)k * SAMPLE_TIME);
    pthread_t running[threads];
    job jobs[threads];
    long groups = out.draws / AT_ONCE;
    for (int t = 0; t < threads; t++) {
        jobs[t] = (job){drawn, table, samples, groups * t / threads * AT_ONCE, groups * (t + 1) / threads * AT_ONCE, out};
        if (t) pthread_create(&running[t], NULL, share, &jobs[t]);
    }
    share(&jobs[0]);
    for (int t = 1; t < threads; t++) pthread_join(running[t], NULL);
    free(table);
}

int at_once(void) { return AT_ONCE; }
