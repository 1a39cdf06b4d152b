/* Replays recorded flights through the monitor and compares its flags and every bit of its state.
 *
 *   monitor-bench FILE      a recording of dssc-jax code --monitor
 *
 * Exit code: 0 the same, 1 not the same, 2 no recording.
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
static const char magic[] = "dssc-jax monitor 1";
static const char *const names[] = {@{names}};

static bits bits_of(real x)
{
    bits same;
    memcpy(&same, &x, sizeof same);
    return same;
}

static bool same(real a, real b)
{
    return bits_of(a) == bits_of(b) || (isnan(a) && isnan(b)); /* the bits of a NaN are the processor's own */
}

static void advance(@{name} *monitor, const real *row, real *results)
{
    @{name}_sample seen;
    @{give}
    results[0] = (real)@{name}_step(monitor, &seen);
    results[1] = (real)monitor->latched;
    @{take}
}

int main(int count, char **words)
{
    char head[sizeof magic - 1 + 2];
    uint32_t samples;
    uint64_t compared = 0, differing = 0, flights = 0, raised = 0;
    FILE *const file = count == 2 ? fopen(words[1], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "monitor-bench: %s\n", count == 2 ? strerror(errno) : "usage: monitor-bench FILE");
        return 2;
    }
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, magic, sizeof magic - 1) != 0
        || (unsigned char)head[sizeof magic - 1] != 8 * sizeof(real)) {
        fprintf(stderr, "monitor-bench: no recording of %u bits a number\n", (unsigned)(8 * sizeof(real)));
        return 2;
    }
    while (fread(&samples, 1, sizeof samples, file) == sizeof samples) {
        @{name} monitor;
        @{name}_init(&monitor);
        for (uint32_t k = 0; k < samples; k++) {
            real row[INPUTS + RESULTS], results[RESULTS];
            if (fread(row, sizeof(real), INPUTS + RESULTS, file) != INPUTS + RESULTS) {
                fprintf(stderr, "monitor-bench: the recording ends too early\n");
                return 2;
            }
            advance(&monitor, row, results);
            for (unsigned i = 0; i < RESULTS; i++) {
                compared++;
                if (!same(row[INPUTS + i], results[i]) && differing++ == 0) {
                    printf("differs: %s of flight %" PRIu64 ", sample %" PRIu32 ": %.17g instead of %.17g\n", names[i],
                           flights, k, (double)results[i], (double)row[INPUTS + i]);
                }
            }
        }
        raised |= monitor.latched;
        flights++;
    }
    fclose(file);
    printf("monitor: %" PRIu64 " of %" PRIu64 " values differ, %" PRIu64 " flights, flags raised: 0x%" PRIx64 "\n",
           differing, compared, flights, raised);
    return differing != 0 || compared == 0;
}
