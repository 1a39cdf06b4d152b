@{comment}

#ifndef @{guard}
#define @{guard}

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

@{channels}

#ifdef __cplusplus
}
#endif

#endif
