"""The articulated least-squares core: a posed figure, residual terms, and their robust Gauss-Newton."""
