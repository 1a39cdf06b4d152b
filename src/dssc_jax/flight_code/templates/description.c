#ifdef DSSC_JAX_LIBRARY /* what dssc-jax library exports */
#include "dssc_jax_library.h"

@{channels}
DSSC_JAX_LIBRARY_OF(@{addresses});
#endif
