#ifdef DSSC_JAX_LIBRARY /* what dssc-jax library exports */
#define DSSC_JAX_OPTIONAL_TELEMETRY
#include "dssc_jax_library.h"

@{channels}
DSSC_JAX_LIBRARY_OF(@{addresses});
#endif
