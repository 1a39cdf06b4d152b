/* Replays recorded flights through the @{label} and compares its flags and every bit of its state.
 *
 *   @{target}-bench FILE                a recording of dssc-jax code
 *   @{target}-bench --hostile N FILE    N rows of it with hostile numbers: NaN, infinity, denormals, huge ones
 *   @{target}-bench --cycles FILE       time of a row, by the processor's own counter where there is one
 *
 * Exit code: 0 the same, 1 not the same, 2 no recording.
 */
#include "@{name}.h"

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

typedef @{real} real;
typedef uint@{precision}_t bits;
#define INPUTS @{inputs_count}
#define RESULTS @{results_count}
#define EPSILON @{limits}_EPSILON
#define SMALLEST @{limits}_MIN
#define LARGEST @{limits}_MAX
static const char magic[] = "@{magic}";
static const char *const names[] = {@{names}};

@{same_bits}

@{hostile}

static uint32_t advance(@{name} *held, const real *row, uint32_t k, real *results)
{
    @{advance}
}

/* Numbers that a caller may change at any time, such as parameters. */
static void disturb(@{name} *held)
{
    @{disturb}
}

/* The rows of a recording's first flight; NULL: it is none. */
static real *first_flight(FILE *file, uint32_t *rows)
{
    if (fread(rows, 1, sizeof *rows, file) != sizeof *rows || *rows == 0) {
        return NULL;
    }
    const size_t count = (size_t)*rows * (INPUTS + RESULTS);
    real *const numbers = malloc(count * sizeof(real));
    if (numbers != NULL && fread(numbers, sizeof(real), count, file) != count) {
        free(numbers);
        return NULL;
    }
    return numbers;
}

/* Flags are raised, and what was finite stays finite. */
static int hostile(const real *recorded, uint32_t rows, unsigned long count)
{
    @{name} held;
    unsigned long flagged = 0, lost = 0;
    memset(&held, 0, sizeof held);
    for (unsigned long n = 0; n < count; n++) {
        const uint32_t k = (uint32_t)(n % rows);
        real row[INPUTS], results[RESULTS];
        for (unsigned i = 0; i < INPUTS; i++) {
            row[i] = random_bits() % 16 == 0 ? hostile_number() : recorded[(size_t)k * (INPUTS + RESULTS) + i];
        }
        if (k != 0 && random_bits() % 64 == 0) {
            disturb(&held);
        }
        flagged += advance(&held, row, k, results) != 0;
        for (unsigned i = 0; i < RESULTS && @{stays_finite}; i++) {
            lost += !(fabs((double)results[i]) <= DBL_MAX);
        }
    }
    printf("@{label}: %lu hostile rows, %lu with a flag, %lu numbers lost\n", count, flagged, lost);
    return lost != 0;
}

static int cycles(const real *recorded, uint32_t rows)
{
#if defined(__x86_64__)
    @{name} held;
    uint64_t least = UINT64_MAX, most = 0, total = 0;
    for (uint32_t k = 0; k < rows; k++) {
        real results[RESULTS];
        const uint64_t begin = __rdtsc();
        advance(&held, recorded + (size_t)k * (INPUTS + RESULTS), k, results);
        const uint64_t spent = __rdtsc() - begin;
        least = spent < least ? spent : least;
        most = spent > most ? spent : most;
        total += spent;
    }
    printf("@{label}: cycles of a @{row}, by the time stamp counter: least %" PRIu64 ", mean %" PRIu64 ", most %" PRIu64 "\n",
           least, total / rows, most);
#else
    (void)recorded;
    (void)rows;
    printf("no counter of cycles is known here\n");
#endif
    return 0;
}

int main(int count, char **words)
{
    char head[sizeof magic];
    uint32_t rows;
    uint64_t compared = 0, differing = 0, flights = 0, raised = 0;
    const bool is_hostile = count == 4 && strcmp(words[1], "--hostile") == 0;
    const bool is_timed = count == 3 && strcmp(words[1], "--cycles") == 0;
    const bool known = count == 2 || is_hostile || is_timed;
    FILE *const file = known ? fopen(words[count - 1], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "@{target}-bench: %s\n", known ? strerror(errno) : "usage: @{target}-bench [--hostile N | --cycles] FILE");
        return 2;
    }
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, magic, sizeof magic - 1) != 0
        || (unsigned char)head[sizeof magic - 1] != 8 * sizeof(real)) {
        fprintf(stderr, "@{target}-bench: no recording of %u bits a number\n", (unsigned)(8 * sizeof(real)));
        return 2;
    }
    if (is_hostile || is_timed) {
        real *const recorded = first_flight(file, &rows);
        fclose(file);
        if (recorded == NULL) {
            fprintf(stderr, "@{target}-bench: the recording has no flight\n");
            return 2;
        }
        const int code = is_hostile ? hostile(recorded, rows, strtoul(words[2], NULL, 10)) : cycles(recorded, rows);
        free(recorded);
        return code;
    }
    while (fread(&rows, 1, sizeof rows, file) == sizeof rows) {
        @{name} held;
        for (uint32_t k = 0; k < rows; k++) {
            real row[INPUTS + RESULTS], results[RESULTS];
            if (fread(row, sizeof(real), INPUTS + RESULTS, file) != INPUTS + RESULTS) {
                fprintf(stderr, "@{target}-bench: the recording ends too early\n");
                return 2;
            }
            raised |= advance(&held, row, k, results);
            for (unsigned i = 0; i < RESULTS; i++) {
                compared++;
                if (!same(row[INPUTS + i], results[i]) && differing++ == 0) {
                    printf("differs: %s of flight %" PRIu64 ", @{row} %" PRIu32 ": %.17g instead of %.17g\n", names[i],
                           flights, k, (double)results[i], (double)row[INPUTS + i]);
                }
            }
        }
        flights++;
    }
    fclose(file);
    printf("@{label}: %" PRIu64 " of %" PRIu64 " values differ, %" PRIu64 " flights, flags raised: 0x%" PRIx64 "\n",
           differing, compared, flights, raised);
    return differing != 0 || compared == 0;
}
