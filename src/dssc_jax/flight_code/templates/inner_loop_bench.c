/* Replays recorded flights through the inner loop and compares every bit of its state and its commands.
 *
 *   inner-loop-bench FILE      a recording of dssc-jax code
 *
 * A flight is compared up to the first number that is not finite. Exit code: 0 the same, 1 not the same, 2 no recording.
 */
#include "@{name}.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

typedef @{real} real;
typedef uint@{precision}_t bits;
#define INPUTS @{inputs_count}
#define RESULTS @{results_count}
static const char magic[] = "dssc-jax inner loop 1";
static const char *const names[] = {@{names}};

static bits bits_of(real x)
{
    bits same;
    memcpy(&same, &x, sizeof same);
    return same;
}

static unsigned advance(@{name} *inner_loop, const real *row, uint32_t tick, real *results)
{
    @{name}_readings seen;
    @{name}_commands wanted;
    unsigned flags = 0;
    @{give}
    @{command}
    if (tick == 0) {
        flags |= @{name}_init(inner_loop, &seen);
    }
    if (tick % @{ticks} == 0) {
        flags |= @{name}_sample(inner_loop, &seen, &wanted);
    }
    flags |= @{name}_tick(inner_loop, &seen);
    @{take}
    return flags;
}

int main(int count, char **words)
{
    char head[sizeof magic - 1 + 3];
    uint32_t ticks;
    uint64_t compared = 0, differing = 0, flights = 0;
    FILE *const file = count == 2 ? fopen(words[1], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "inner-loop-bench: %s\n", count == 2 ? strerror(errno) : "usage: inner-loop-bench FILE");
        return 2;
    }
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, magic, sizeof magic - 1) != 0
        || (unsigned char)head[sizeof magic - 1] != 8 * sizeof(real)) {
        fprintf(stderr, "inner-loop-bench: no recording of %u bits a number\n", (unsigned)(8 * sizeof(real)));
        return 2;
    }
    while (fread(&ticks, 1, sizeof ticks, file) == sizeof ticks) {
        @{name} inner_loop;
        bool finite = true;
        for (uint32_t k = 0; k < ticks; k++) {
            real row[INPUTS + RESULTS], results[RESULTS];
            if (fread(row, sizeof(real), INPUTS + RESULTS, file) != INPUTS + RESULTS) {
                fprintf(stderr, "inner-loop-bench: the recording ends too early\n");
                return 2;
            }
            for (unsigned i = 0; i < INPUTS + RESULTS; i++) {
                finite = finite && isfinite(row[i]);
            }
            if (!finite) {
                continue;
            }
            if (advance(&inner_loop, row, k, results) != 0) {
                printf("flag: tick %" PRIu32 " of flight %" PRIu64 "\n", k, flights);
                differing++;
            }
            for (unsigned i = 0; i < RESULTS; i++) {
                compared++;
                if (bits_of(row[INPUTS + i]) != bits_of(results[i]) && differing++ == 0) {
                    printf("differs: %s of flight %" PRIu64 ", tick %" PRIu32 ": %.17g instead of %.17g\n", names[i],
                           flights, k, (double)results[i], (double)row[INPUTS + i]);
                }
            }
        }
        flights++;
    }
    fclose(file);
    printf("inner loop: %" PRIu64 " of %" PRIu64 " values differ, %" PRIu64 " flights\n", differing, compared, flights);
    return differing != 0 || compared == 0;
}
