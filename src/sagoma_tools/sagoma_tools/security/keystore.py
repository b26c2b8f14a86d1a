"""A keystore as ROS 2 reads it: one authority, and for each process a folder with its certificate and permissions.

    KEYSTORE/private/ca.key.pem                     the authority's key: keep it off the camera PCs
    KEYSTORE/public/ca.cert.pem
    KEYSTORE/enclaves/governance.p7s                the domain's rules, signed
    KEYSTORE/enclaves/sagoma/NAME/...               what the process NAME needs, its private key among it

Keys are of the curve P-256 and documents are signed as S/MIME (DDS Security 1.1, 9.3 and 9.4), as `ros2 security` does.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import pkcs7
from cryptography.x509.oid import NameOID

from capture_rig.errors import InputError
from capture_rig.files import make_folder, read_text, write_text

from ..graph.process_group import ENCLAVES
from .access import Access, governance_xml, permissions_xml

AUTHORITY = "sagoma"
VALID_DAYS = 3650  # as `ros2 security` has it
CLOCKS_APART = timedelta(days=1)  # of hosts that are not in step when the keys are made
PRIVATE_MODE = 0o600


@dataclass(frozen=True)
class Authority:
    """The certificate authority: it signs certificates and permissions."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate

    @classmethod
    def new(cls, valid: tuple[datetime, datetime]) -> Authority:
        """Make a key, and a certificate that it signs itself."""
        key = ec.generate_private_key(ec.SECP256R1())
        return cls(key, _certificate(AUTHORITY, key.public_key(), AUTHORITY, key, valid))

    @classmethod
    def load(cls, keystore: Path) -> Authority:
        """Read the authority of a keystore. Raises InputError where it is not there or no such thing."""
        try:
            key = serialization.load_pem_private_key(_read(keystore / "private" / "ca.key.pem"), None)
            certificate = x509.load_pem_x509_certificate(_read(keystore / "public" / "ca.cert.pem"))
        except ValueError as error:
            raise InputError(f"holds no authority ({error})", where=str(keystore), remedy="Make a new one.") from None
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        return cls(key, certificate)

    def save(self, keystore: Path) -> None:
        """Write it into a keystore."""
        for folder, mode in (("private", 0o700), ("public", 0o755)):
            make_folder(keystore / folder)
            (keystore / folder).chmod(mode)
        _write_private(keystore / "private" / "ca.key.pem", self.key)
        write_text(keystore / "public" / "ca.cert.pem", _pem(self.certificate))

    def signed(self, document: str) -> str:
        """Return a document as S/MIME with a detached signature."""
        builder = pkcs7.PKCS7SignatureBuilder().set_data(document.encode())
        builder = builder.add_signer(self.certificate, self.key, hashes.SHA256())
        smime = builder.sign(serialization.Encoding.SMIME, [pkcs7.PKCS7Options.DetachedSignature])
        return smime.decode()


def write_keystore(keystore: Path, accesses: dict[str, Access], domain_id: int) -> list[Path]:
    """Write the enclave of each process (its name -> what it may do) and the domain's rules; returns the folders.

    The authority is made when the keystore is new; of one that exists the enclaves are written anew. Raises InputError
    for files that cannot be read or written.
    """
    now = datetime.now(UTC)
    valid = now - CLOCKS_APART, now + timedelta(days=VALID_DAYS)
    if (keystore / "private" / "ca.key.pem").exists():
        authority = Authority.load(keystore)
    else:
        authority = Authority.new(valid)
        authority.save(keystore)
    enclaves = make_folder(keystore / "enclaves")
    governance = authority.signed(governance_xml(domain_id))
    write_text(enclaves / "governance.p7s", governance)
    folders = []
    for name, access in sorted(accesses.items()):
        folder, enclave = make_folder(enclaves / ENCLAVES.strip("/") / name), f"{ENCLAVES}/{name}"
        key = ec.generate_private_key(ec.SECP256R1())
        certificate = _certificate(enclave, key.public_key(), AUTHORITY, authority.key, valid)
        permissions = permissions_xml(enclave, access, domain_id, valid)
        _write_private(folder / "key.pem", key)
        for file, text in {
            "cert.pem": _pem(certificate),
            "identity_ca.cert.pem": _pem(authority.certificate),
            "permissions_ca.cert.pem": _pem(authority.certificate),
            "governance.p7s": governance,
            "permissions.xml": permissions,
            "permissions.p7s": authority.signed(permissions),
        }.items():
            write_text(folder / file, text)
        folders.append(folder)
    return folders


def _certificate(
    name: str,
    key: ec.EllipticCurvePublicKey,
    issuer: str,
    issuer_key: ec.EllipticCurvePrivateKey,
    valid: tuple[datetime, datetime],
) -> x509.Certificate:
    is_authority = name == issuer
    builder = x509.CertificateBuilder().subject_name(_name(name)).issuer_name(_name(issuer)).public_key(key)
    builder = builder.serial_number(x509.random_serial_number()).not_valid_before(valid[0]).not_valid_after(valid[1])
    builder = builder.add_extension(x509.BasicConstraints(is_authority, 1 if is_authority else None), critical=True)
    return builder.sign(issuer_key, hashes.SHA256())


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(serialization.Encoding.PEM).decode()


def _read(path: Path) -> bytes:
    return read_text(path, "Give the folder of a keystore.").encode()


def _write_private(path: Path, key: ec.EllipticCurvePrivateKey) -> None:
    """Write a private key that only its owner may read, from the first byte on."""
    pem = key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    umask = os.umask(0o777 & ~PRIVATE_MODE)
    try:
        write_text(path, pem.decode())
    finally:
        os.umask(umask)
    path.chmod(PRIVATE_MODE)
