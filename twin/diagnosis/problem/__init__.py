"""The statistical problem of a diagnosis: fitted set-up, measurement noise, whitened readings and candidates' signatures."""
