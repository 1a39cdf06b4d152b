DSSC_JAX_EXCHANGE(@{name})
@{tables}
DSSC_JAX_CONTROLLER(@{name}, @{sample_time}, @{parameters}, @{telemetry});
