@{flags}
#define @{flag_count} @{count}

/* What the monitor sees at a sample: what the controllers get, and what they give and report. A number that
 * is not known is NAN: it raises no flag and clears none. */
typedef struct {
    @{inputs}
} @{name}_sample;

typedef struct {
    uint32_t current;  /* the flags that the last sample raised */
    uint32_t latched;  /* the flags that were raised since init */
    int32_t sample;    /* number of samples since init, 2147483647 at most */
    int32_t first[@{flag_count}];  /* for each bit the sample, from 0 on, that raised it first; -1: none has */
    struct {
        @{memories}
    } memory;
} @{name};

/* No flag, nothing seen. To be called where the controllers are initialised or reset. */
void @{name}_init(@{name} *monitor);

/* One sample, once the controllers have made theirs. Returns the flags that it raises. */
uint32_t @{name}_step(@{name} *monitor, const @{name}_sample *seen);
