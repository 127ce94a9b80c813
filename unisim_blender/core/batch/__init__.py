"""Many scenarios into one folder or object store: jobs, units of work, the records that commit them, the manifest."""
