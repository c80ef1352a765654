"""Files of depth networks on the Hugging Face hub."""

import re
from pathlib import Path
from typing import NamedTuple

from uwaug._support.extras import require


class HubFile(NamedTuple):
    """File of a repository on the hub.

    Attributes:
        repository: owner/name.
        file: path in the repository.
        revision: commit, branch or tag; None for the newest.
    """

    repository: str
    file: str
    revision: str | None = None


NAMED = {
    "depth-anything-v2-small": HubFile(
        "onnx-community/depth-anything-v2-small",  # Apache-2.0, 99 MB
        "onnx/model.onnx",
        "4472b7362082ad9968fee890ca0f1e5aca36b93d",
    )
}
"""Networks by name. The options of `Network` are theirs by default."""

_ADDRESS = re.compile(r"([\w.-]+/[\w.-]+):([^:]+)")


def hub_file(name: str, revision: str | None = None) -> HubFile | None:
    """Find the file that a name of `NAMED` or an address, owner/name:file, stands for.

    Args:
        name: name or address.
        revision: commit, branch or tag in place of the usual one.

    Returns:
        The file; None if it is neither a name nor an address.
    """
    address = _ADDRESS.fullmatch(name)
    file = HubFile(*address.groups()) if address else NAMED.get(name)
    return file._replace(revision=revision) if file and revision else file


def fetched(file: HubFile) -> Path:
    """Fetch a file of the hub once, into the cache of huggingface_hub, which shows its progress.
    Offline mode, mirrors and tokens are set as that library has them (`HF_HUB_OFFLINE`,
    `HF_ENDPOINT`, `HF_TOKEN`).

    Raises:
        ImportError: huggingface_hub is not installed.
        ValueError: the hub knows no repository of such a name.
        FileNotFoundError: there is no such repository, revision or file.
        PermissionError: the repository asks for an account.
        ConnectionError: it is not in the cache, and could not be fetched.
    """
    hub, errors = require("hub", "huggingface_hub", "huggingface_hub.errors")
    address = f"{file.repository}:{file.file}"
    try:
        return Path(hub.hf_hub_download(file.repository, file.file, revision=file.revision))
    except errors.HFValidationError as error:
        raise ValueError(f"{address}: {str(error).splitlines()[0]}") from error
    except errors.GatedRepoError as error:
        cure = "agree to its terms on the hub, then `hf auth login`"
        raise PermissionError(f"{address} asks for an account: {cure}") from error
    except errors.LocalEntryNotFoundError as error:  # also an EntryNotFoundError
        raise _not_fetched(address, "the hub cannot be reached") from error
    except errors.RepositoryNotFoundError as error:
        missing = "repository; a private repository is read after `hf auth login`"
        raise FileNotFoundError(f"{address}: the hub has no such {missing}") from error
    except errors.RevisionNotFoundError as error:
        missing = f"revision {file.revision}"
        raise FileNotFoundError(f"{address}: the hub has no such {missing}") from error
    except errors.EntryNotFoundError as error:
        raise FileNotFoundError(f"{address}: the hub has no such file") from error
    # a download that breaks off raises errors of several libraries, without a common base
    except Exception as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise _not_fetched(address, reason) from error


def _not_fetched(address: str, reason: str) -> ConnectionError:
    cure = "try again, or fetch the file elsewhere and give its path"
    return ConnectionError(f"{address} could not be fetched, {reason}: {cure}")
