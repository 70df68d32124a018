"""A recipe from its start to its report: trained beside plain training, attacked, compared."""
