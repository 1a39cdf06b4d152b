/* Replays recorded draws through the controllers and compares every bit.
 *
 *   bench FILE              a recording of dssc-jax code; - is the standard input
 *   bench --hostile N       N samples of hostile numbers: NaN, infinity, denormals, huge ones, in signals and parameters
 *   bench --cycles N        time of a step, by the processor's own counter where there is one
 *
 * A recorded draw that diverges has numbers that are not finite. The controller holds its last command and state there,
 * which is checked at the first such sample; the samples after it are not compared.
 *
 * Exit code: 0 the same bits, 1 not the same, 2 no recording.
 */
#include <errno.h>
#include <float.h>
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(__x86_64__)
#include <x86intrin.h>
#endif

typedef struct {
    const char *name;
    unsigned parameters;
    unsigned states;
    unsigned results; /* command, state, telemetry */
    unsigned y, y_ref; /* positions in a row */
    double largest; /* of both; larger angles are refused */
    const char *const *result_names;
    const char *const *parameter_names;
} channel_shape;

#include "bench_channels.h" /* real, bits, CHANNELS, shapes, prepare, restart, check, advance */

#define COMMANDS 3u
static const char magic[] = "dssc-jax recording 1";

@{same_bits}

/* What the compiler did to arithmetic, found by numbers that it cannot know. */

static volatile real one = 1, tiny = EPSILON, product, half_ulp = EPSILON / 2;

static bool contracts(void)
{
    const real a = one + tiny, b = one + tiny, a_again = one + tiny, b_again = one + tiny;
    product = a * b;
    const real c = -product;
    const real rest = a_again * b_again + c;
    return rest != 0;
}

static bool reorders(void)
{
    const real huge = one / tiny / tiny, small = one;
    const real back = (huge + small) - huge;
    return back != 0;
}

static bool ignores_nan(void)
{
    volatile real zero = one - one;
    const real missing = zero / zero;
    return !(missing != missing) || missing <= LARGEST;
}

static bool keeps_excess(void)
{
    volatile real sum = one + half_ulp;
    const real held = (one + half_ulp) - one;
    return sum != one || held != 0 || FLT_EVAL_METHOD != 0;
}

static bool flushes(void)
{
    volatile real least = SMALLEST;
    const real half = least / 2;
    return !(half > 0);
}

static unsigned arithmetic_faults(void)
{
    unsigned faults = 0;
#ifdef __FAST_MATH__
    printf("fault: compiled with -ffast-math\n");
    faults++;
#endif
    if (contracts()) {
        printf("fault: products and sums are contracted into one rounding; compile with -ffp-contract=off\n");
        faults++;
    }
    if (reorders()) {
        printf("fault: sums are reordered; compile without -ffast-math and -fassociative-math\n");
        faults++;
    }
    if (ignores_nan()) {
        printf("fault: NaN is taken not to occur; compile without -ffast-math and -ffinite-math-only\n");
        faults++;
    }
    if (keeps_excess()) {
        printf("fault: numbers are kept with excess precision; on 32-bit x86 compile with -msse2 -mfpmath=sse\n");
        faults++;
    }
    if (flushes()) {
        printf("fault: denormal numbers are flushed to zero; link without -ffast-math\n");
        faults++;
    }
    return faults;
}

static void read_exactly(FILE *file, void *to, size_t size)
{
    if (fread(to, 1, size, file) != size) {
        fprintf(stderr, "bench: the recording ends too early\n");
        exit(2);
    }
}

static bool all_finite(const real *numbers, unsigned count)
{
    for (unsigned i = 0; i < count; i++) {
        if (!isfinite(numbers[i])) {
            return false;
        }
    }
    return true;
}

static bool are_valid(const channel_shape *of, const real *row)
{
    return all_finite(row, SIGNALS) && fabs((double)row[of->y]) <= of->largest
        && fabs((double)row[of->y_ref]) <= of->largest;
}

static int replay(FILE *file)
{
    char head[sizeof magic - 1 + 4];
    uint32_t shape[2];
    uint64_t compared = 0, differing = 0, draws = 0, samples = 0;
    read_exactly(file, head, sizeof head);
    if (memcmp(head, magic, sizeof magic - 1) != 0 || (unsigned char)head[sizeof magic - 1] != 8 * sizeof(real)) {
        fprintf(stderr, "bench: no recording of %u bits a number\n", (unsigned)(8 * sizeof(real)));
        return 2;
    }
    while (fread(shape, 1, sizeof shape, file) == sizeof shape) {
        real parameters[MOST_PARAMETERS], row[SIGNALS + MOST_RESULTS], results[MOST_RESULTS];
        real held[MOST_RESULTS] = {0};
        bool diverged = false;
        const uint32_t channel = shape[0];
        if (channel >= CHANNELS) {
            fprintf(stderr, "bench: there is no channel %" PRIu32 "\n", channel);
            return 2;
        }
        const channel_shape *const of = &shapes[channel];
        const unsigned kept = COMMANDS + of->states;
        read_exactly(file, parameters, of->parameters * sizeof(real));
        prepare(channel, parameters);
        const unsigned refused = check(channel);
        if (refused != 0) {
            printf("refused: %s%s of draw %" PRIu64 "\n", of->name, of->parameter_names[refused - 1], draws / CHANNELS);
            differing++;
        }
        for (uint32_t k = 0; k < shape[1]; k++) {
            read_exactly(file, row, (SIGNALS + of->results) * sizeof(real));
            if (diverged) {
                continue;
            }
            const unsigned flag = advance(channel, row, results, true);
            const unsigned expected = !are_valid(of, row) ? 1u : (!all_finite(row + SIGNALS, kept) ? 2u : 0u);
            const real *const wanted = expected == 0 ? row + SIGNALS : held;
            diverged = expected != 0;
            if (flag != expected) {
                printf("flag: %s%u instead of %u, draw %" PRIu64 ", sample %" PRIu32 "\n", of->name, flag, expected,
                       draws / CHANNELS, k);
                differing++;
            }
            for (unsigned i = 0; i < (diverged ? kept : of->results); i++) {
                compared++;
                if (!same(wanted[i], results[i])) {
                    if (differing++ == 0) {
                        printf("differs: %s%s of draw %" PRIu64 ", sample %" PRIu32 ": %.17g instead of %.17g\n",
                               of->name, of->result_names[i], draws / CHANNELS, k, (double)results[i],
                               (double)wanted[i]);
                    }
                }
            }
            memcpy(held, row + SIGNALS, kept * sizeof(real));
            samples++;
        }
        draws++;
    }
    const unsigned faults = arithmetic_faults();
    printf("%" PRIu64 " of %" PRIu64 " values differ, %" PRIu64 " draws, %" PRIu64 " samples\n", differing, compared,
           draws / CHANNELS, samples);
    return differing != 0 || faults != 0 || compared == 0;
}

/* Hostile input */

@{hostile}

/* A flag tells the truth, and neither a command nor a state is ever lost. */
static int hostile(unsigned long count)
{
    unsigned long broken = 0, wrong = 0;
    for (unsigned channel = 0; channel < CHANNELS; channel++) {
        const channel_shape *const of = &shapes[channel];
        const unsigned kept = COMMANDS + of->states;
        real parameters[MOST_PARAMETERS], row[SIGNALS], results[MOST_RESULTS], held[MOST_RESULTS] = {0};
        prepare(channel, NULL);
        for (unsigned long k = 0; k < count; k++) {
            if (random_bits() % 16 == 0) {
                for (unsigned i = 0; i < of->parameters; i++) {
                    parameters[i] = hostile_number();
                }
                prepare(channel, random_bits() % 2 == 0 ? parameters : NULL);
                memset(held, 0, sizeof held);
            }
            for (unsigned i = 0; i < SIGNALS; i++) {
                row[i] = hostile_number();
            }
            const unsigned flag = advance(channel, row, results, random_bits() % 2 == 0);
            bool right = (flag == 1) == !are_valid(of, row) && flag <= 2 && all_finite(results, kept);
            for (unsigned i = 0; i < kept && flag != 0; i++) {
                right = right && same(results[i], held[i]);
            }
            wrong += !right;
            broken += flag != 0;
            memcpy(held, results, kept * sizeof(real));
            if (flag == 2 && random_bits() % 2 == 0) {
                restart(channel);
                memset(held + COMMANDS, 0, of->states * sizeof(real));
            }
        }
    }
    printf("%lu hostile samples of each channel: %lu with a flag, %lu with a wrong flag\n", count, broken, wrong);
    return wrong != 0;
}

static int cycles(unsigned long count)
{
#if defined(__x86_64__)
    for (unsigned channel = 0; channel < CHANNELS; channel++) {
        real row[SIGNALS] = {0}, results[MOST_RESULTS];
        uint64_t least = UINT64_MAX, most = 0, total = 0;
        prepare(channel, NULL);
        for (unsigned long k = 0; k < count; k++) {
            row[0] = (real)((double)(random_bits() >> 11) / 9007199254740992.0);
            const uint64_t begin = __rdtsc();
            advance(channel, row, results, false);
            const uint64_t spent = __rdtsc() - begin;
            least = spent < least ? spent : least;
            most = spent > most ? spent : most;
            total += spent;
        }
        printf("%scycles of a step, by the time stamp counter: least %" PRIu64 ", mean %" PRIu64 ", most %" PRIu64 "\n",
               shapes[channel].name, least, total / count, most);
    }
    return 0;
#else
    (void)count;
    printf("no counter of cycles is known here\n");
    return 0;
#endif
}

int main(int count, char **words)
{
    if (count == 3 && strcmp(words[1], "--hostile") == 0) {
        return hostile(strtoul(words[2], NULL, 10));
    }
    if (count == 3 && strcmp(words[1], "--cycles") == 0) {
        return cycles(strtoul(words[2], NULL, 10));
    }
    if (count != 2) {
        fprintf(stderr, "usage: bench FILE | bench --hostile N | bench --cycles N\n");
        return 2;
    }
    FILE *const file = strcmp(words[1], "-") == 0 ? stdin : fopen(words[1], "rb");
    if (file == NULL) {
        fprintf(stderr, "bench: cannot read %s: %s\n", words[1], strerror(errno));
        return 2;
    }
    return replay(file);
}
