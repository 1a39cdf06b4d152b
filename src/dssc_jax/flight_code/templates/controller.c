@{definitions}
@{is_finite}

@{functions}

@{description}
