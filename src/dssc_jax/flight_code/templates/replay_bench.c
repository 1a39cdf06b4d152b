/* Replays recorded flights through the @{label} and compares its flags and every bit of its state.
 *
 *   @{target}-bench FILE      a recording of dssc-jax code
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
static const char magic[] = "@{magic}";
static const char *const names[] = {@{names}};

@{same_bits}

static uint32_t advance(@{name} *held, const real *row, uint32_t k, real *results)
{
    @{advance}
}

int main(int count, char **words)
{
    char head[sizeof magic];
    uint32_t rows;
    uint64_t compared = 0, differing = 0, flights = 0, raised = 0;
    FILE *const file = count == 2 ? fopen(words[1], "rb") : NULL;
    if (file == NULL) {
        fprintf(stderr, "@{target}-bench: %s\n", count == 2 ? strerror(errno) : "usage: @{target}-bench FILE");
        return 2;
    }
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, magic, sizeof magic - 1) != 0
        || (unsigned char)head[sizeof magic - 1] != 8 * sizeof(real)) {
        fprintf(stderr, "@{target}-bench: no recording of %u bits a number\n", (unsigned)(8 * sizeof(real)));
        return 2;
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
