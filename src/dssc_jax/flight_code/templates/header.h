@{comment}

#ifndef @{guard}
#define @{guard}

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

@{declarations}

#ifdef __cplusplus
}
#endif

#endif
