"""The Hugging Face Hub: listing, fetching and committing files of repositories, independent of their content."""
