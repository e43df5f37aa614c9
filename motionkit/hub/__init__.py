"""The Hugging Face Hub: what a repository holds, fetching of it, committing to it; nothing of what the files are."""
