"""Pictures of the tables of a study: tables in, figures out, nothing computed anew."""
