"""The analyses of a study, one file each. They return and write tables; they draw and print nothing."""
