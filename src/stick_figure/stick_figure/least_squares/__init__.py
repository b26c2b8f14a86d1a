"""The articulated least-squares core: a placed figure, residual terms, and their robust Gauss-Newton."""
