DSSC_JAX_EXCHANGE(@{name})
@{tables}
DSSC_JAX_CONTROLLER_OF_SIGNALS(@{name}, @{sample_time}, @{parameters}, @{telemetry}, @{measured});
