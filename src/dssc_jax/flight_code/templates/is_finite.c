static bool is_finite(@{real} x)
{
    return @{fabs}(x) <= @{largest};
}
